"""Envelopes of a wavy mirror, whose map is known by quadrature, and of the same scene moved."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.gallery.meshes import grid_faces

LIGHT = np.array([0.0, 0.6, -0.8])
WIDTH, N_COLUMNS = 0.4, 512
X = np.linspace(-0.5, 0.5, N_COLUMNS + 1)
HEIGHT, SLOPE = 0.02 * np.sin(9.0 * X), 0.18 * np.cos(9.0 * X)
NORMALS = np.column_stack([-SLOPE, np.zeros_like(X), np.ones_like(X)])
NORMALS /= np.hypot(1.0, SLOPE)[:, np.newaxis]
N_TEXELS = 200


def wave_scene(turn=None, scale=1.0, *, swapped=False):
    """A mirror with a wave along x, a ceiling that it lights, turned and scaled."""
    turn = np.eye(3) if turn is None else turn
    rows = [np.column_stack([X, np.full_like(X, y), HEIGHT]) for y in (-WIDTH / 2, WIDTH / 2)]
    faces = grid_faces(2, N_COLUMNS + 1)
    if swapped:
        faces = np.random.default_rng(5).permutation(faces)
    mirror = trimesh.Trimesh(
        scale * np.concatenate(rows) @ turn.T,
        faces,
        vertex_normals=np.tile(NORMALS, (2, 1)) @ turn.T,
        process=False,
    )
    corners = np.array([[-3, 0.05, 1], [3, 0.05, 1], [3, 2, 1], [-3, 2, 1]])
    ceiling = trimesh.Trimesh(scale * corners @ turn.T, [[0, 2, 1], [0, 3, 2]], process=False)
    objects = [
        pr.SceneObject(ceiling, pr.Diffuse()),
        pr.SceneObject(mirror, pr.Mirror(1.0), smooth=True),
    ]
    return pr.Scene(objects[:: -1 if swapped else 1], [pr.CollimatedEmitter(turn @ LIGHT)])


def found(turn=None, scale=1.0, *, swapped=False, **limits):
    """Flux over bands of the ceiling along x, that of all, and the error that is told."""
    scene = wave_scene(turn, scale, swapped=swapped)
    envelope = pr.trace_envelope(scene, footprint=0.01 * scale, n_threads=1, **limits)
    field = pr.irradiance_field(envelope, method="envelope", n_threads=1)
    turn = np.eye(3) if turn is None else turn
    frame = (scale * turn @ each for each in ([-1, 0, 1], [0, 2, 0], [2, 0, 0]))
    bands = pr.irradiance_map(field, *frame, (1, N_TEXELS))[..., 0].ravel()
    return bands * 4.0 / N_TEXELS, envelope


@pytest.fixture(scope="module")
def exact():
    """The same by quadrature, of rays that meet facets with interpolated normals."""
    n = 1_000_000
    x = (np.arange(n) + 0.5) / n - 0.5
    normal = np.column_stack([np.interp(x, X, NORMALS[:, i]) for i in range(3)])
    normal /= np.linalg.norm(normal, axis=1)[:, np.newaxis]
    out = LIGHT - 2.0 * (normal @ LIGHT)[:, np.newaxis] * normal
    at = x + out[:, 0] / out[:, 2] * (1.0 - np.interp(x, X, HEIGHT))
    edges = np.linspace(-1.0, 1.0, N_TEXELS + 1)
    return np.histogram(at, edges)[0] * (0.8 * WIDTH / n)


def test_error_is_that_of_quadrature_and_falls_fast_with_rays(exact):
    """Below a thousandth at 50,000 rays, and falling at least as rays to the -1.2."""
    errors, told = [], []
    for n_rays in (12_000, 50_000):
        bands, envelope = found(n_rays=n_rays)
        errors.append(np.abs(bands - exact).sum() / exact.sum())
        told.append(envelope.error)
        assert 0.85 * n_rays < envelope.n_rays <= n_rays
    assert errors[1] < 1e-3
    assert errors[1] / errors[0] < (50_000 / 12_000) ** -1.2
    assert all(
        error < 1.2 * estimate < 8.0 * error for error, estimate in zip(errors, told, strict=True)
    )


TURNS = {
    "about the vertical": trimesh.transformations.rotation_matrix(0.7, [0, 0, 1])[:3, :3],
    "about any axis": trimesh.transformations.rotation_matrix(2.0, [1, -2, 3])[:3, :3],
}


@pytest.mark.parametrize(
    "change",
    [*({"turn": turn} for turn in TURNS.values()), {"scale": 1000.0}, {"swapped": True}],
    ids=[*TURNS, "in other units", "in another order"],
)
def test_maps_do_not_depend_on_how_the_scene_is_given(change):
    bands, envelope = found(error=0.02)
    again, _ = found(error=0.02, **change)
    assert np.abs(again - bands).sum() < 0.1 * envelope.error * bands.sum()


def test_memory_grows_with_elements_by_less_than_400_bytes_each():
    _, envelope = found(error=0.01)
    arrays = ("position", "normal", "flux", "place", "sheet", "misplaced", "chart")
    n_bytes = sum(getattr(envelope, name).nbytes for name in arrays)
    assert n_bytes < 400 * len(envelope)
