"""Every method keeps constant and linear fields and energy, whatever the order and the threads.

Photons lie on a plane whose coordinates are those of their emitter. A method that needs more than
the defaults has a `Case` below that says why.
"""

import gc
import weakref
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import photonrelax as pr
from photonrelax.estimation.methods import PHOTON_METHODS, MethodInput, Settings, relaxed_photons
from tests.helpers.photon_maps import flat_map, plane, uniform_map, unit_square


@dataclass(frozen=True)
class Case:
    """Parameters of the tests of a method, or of a variant of one."""

    method: str | None = None
    # Settings objects by name, for lengths in this unit.
    settings: Callable[[float], dict] = lambda unit: {}
    # Photons as the method needs them, for lengths in this unit.
    photons: Callable[[pr.PhotonMap, float], pr.PhotonMap] = lambda photons, unit: photons


REFINEMENTS = ("differential-checking", "bias-compensation")


def refined(name):
    return {"gather": pr.GatherSettings(k=60, refinement=name)}


def with_spectra(photons, unit):
    """One in five photons says that discs need not be smaller than 0.7 to 1.4 hundredths."""
    u = photons.emitter_coords[:, 0]
    known = 1000.0 * u % 1.0 < 0.2
    a = np.where(known, 25.0 * (1.0 + 3.0 * u) / unit**2, np.nan)
    rest = np.where(known, 0.0, np.nan)
    return photons.replace(spectrum=np.column_stack([a, rest, rest]))


CASES = {
    "frequency": Case(photons=with_spectra),
    # More photons than there are: kernels reach as far as they may.
    "diffusion, k > n": Case(
        "diffusion",
        lambda unit: {"diffusion": pr.DiffusionSettings(k=10**6, bandwidth=0.06 * unit)},
    ),
    **{name: Case("standard", lambda unit, name=name: refined(name)) for name in REFINEMENTS},
}
NAMES = (*PHOTON_METHODS, *REFINEMENTS, "diffusion, k > n")


def field(name, photons, unit=1.0, **others):
    case = CASES.get(name, Case())
    method = case.method or name
    photons = case.photons(photons, unit)
    return pr.irradiance_field(photons, method=method, **case.settings(unit), **others)


def estimates(name, photons, points, normals, unit=1.0, **others):
    return field(name, photons, unit, **others)(points, normals)


def grid(low, high, n):
    """n·n points in the middle of the cells of a square, and their normals."""
    ticks = low + (high - low) * (np.arange(n) + 0.5) / n
    return plane(np.stack(np.meshgrid(ticks, ticks), -1).reshape(-1, 2))


PROFILES = {
    "constant": (lambda u: u, lambda x: np.ones_like(x)),
    # By inversion of the flux up to x, x + x² over 2.
    "linear": (lambda u: np.sqrt(0.25 + 2 * u) - 0.5, lambda x: 0.5 + x),
}


@pytest.fixture(scope="module")
def lit_squares():
    """A watt on the unit square by each profile, of random and of Halton photons."""
    maps = {}
    for profile, (inverse, _) in PROFILES.items():
        for kind in ("random", "halton"):
            uv = unit_square(40_000, kind, seed=4)
            xy = np.column_stack([inverse(uv[:, 0]), uv[:, 1]])
            maps[profile, kind] = flat_map(xy, 40_000, coords=uv, well_spaced=kind == "halton")
    return maps


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("kind", ["random", "halton"])
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("method", NAMES)
def test_constant_and_linear_fields_are_kept(method, profile, kind, lit_squares):
    """Means over strips a tenth wide, against the photons that are in each.

    Photons within a bandwidth of a strip count as well, and random ones may be more or fewer.
    """
    photons = lit_squares[profile, kind]
    points, normals = grid(0.1, 0.9, 128)
    found = estimates(method, photons, points, normals)[:, 0]
    edges = np.linspace(0.1, 0.9, 9)
    field_there = PROFILES[profile][1](points[:, 0])
    middle = np.abs(photons.position[:, 1] - 0.5) < 0.4
    lit = np.histogram(photons.position[middle, 0], edges)[0] / 40_000 / 0.08
    centres = PROFILES[profile][1](0.5 * (edges[1:] + edges[:-1]))
    strip = np.digitize(points[:, 0], edges) - 1
    ratio = np.bincount(strip, found) / np.bincount(strip, field_there)
    tolerance = {"random": 0.02, "halton": 0.01}[kind]
    np.testing.assert_allclose(ratio, lit / centres, rtol=tolerance)


@cache
def gain(method, kind, n, **how):
    """Energy estimated on a plane around a disc of light of radius 0.4, over its photons', - 1."""
    xy = unit_square(n, kind, seed=6)
    photons = flat_map(xy[np.linalg.norm(xy - 0.5, axis=1) < 0.4], n, well_spaced=kind == "halton")
    found = estimates(method, photons, *grid(-0.25, 1.25, 250), **how)
    return (found.mean(axis=0) * 1.5**2 / photons.flux.sum(axis=0) - 1.0)[0]


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("kind", ["random", "halton"])
@pytest.mark.parametrize("method", NAMES)
def test_energy_is_kept_where_kernels_are_small_beside_the_light(method, kind):
    """Of 80,000 photons a square metre, 500 lie within an eighth of the radius of the light."""
    assert gain(method, kind, 80_000) == pytest.approx(0.0, abs=0.01)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize(
    ("method", "kind", "gains"),
    [
        ("diffusion", "random", (-0.060, -0.018, -0.006)),
        ("diffusion", "halton", (-0.078, -0.025, -0.009)),
        ("progressive", "random", (0.027, 0.012, 0.004)),
        ("frequency", "halton", (0.029, 0.012, 0.004)),
    ],
)
def test_energy_gained_or_lost_at_an_edge_falls_with_the_size_of_kernels(method, kind, gains):
    """As measured with 5000, 20,000 and 80,000 photons a square metre, kernels half as wide each.

    Kernels of 500 photons, which narrow at the edge of the light, lose some of it there; discs
    that start with 15 photons of one of 16 passes spill light over it.
    """
    passes = {"progressive": pr.ProgressiveSettings(k=15, n_passes=16)}
    how = {} if method == "diffusion" else passes
    found = [gain(method, kind, n, **how) for n in (5000, 20_000, 80_000)]
    np.testing.assert_allclose(found, gains, atol=0.001)
    assert (np.abs(found[1:]) < 0.5 * np.abs(found[:-1])).all()


@pytest.fixture(scope="module")
def patch():
    """Random photons of a linear field and points among them."""
    uv = unit_square(3000, "random", seed=7)
    photons = flat_map(np.column_stack([np.sqrt(uv[:, 0]), uv[:, 1]]), 3000, coords=uv)
    return photons, *plane(np.random.default_rng(8).uniform(0.1, 0.9, (400, 2)))


@pytest.mark.parametrize("method", NAMES)
def test_rotation_of_the_scene_does_not_matter(method, patch):
    photons, points, normals = patch
    turn = Rotation.from_rotvec([0.7, -1.9, 0.4]).as_matrix().T
    turned = photons.replace(position=photons.position @ turn, normal=photons.normal @ turn)
    before = estimates(method, photons, points, normals)
    after = estimates(method, turned, points @ turn, normals @ turn)
    np.testing.assert_allclose(after, before, rtol=1e-6)


@pytest.mark.parametrize("method", NAMES)
def test_irradiance_goes_with_the_inverse_square_of_the_unit_of_length(method, patch):
    photons, points, normals = patch
    unit = 37.0
    larger = photons.replace(position=unit * photons.position)
    before = estimates(method, photons, points, normals)
    after = estimates(method, larger, unit * points, normals, unit)
    np.testing.assert_allclose(unit**2 * after, before, rtol=1e-6)


@pytest.mark.parametrize("flux", [1e-100, 1e100])
@pytest.mark.parametrize("unit", [1e-100, 1e100])
@pytest.mark.parametrize("method", NAMES)
def test_units_may_be_tiny_or_huge(method, unit, flux, patch):
    photons, points, normals = patch
    other = photons.replace(
        position=unit * photons.position,
        flux=flux * photons.flux,
        emitter_coords=unit * photons.emitter_coords,
        emitter_density=photons.emitter_density / unit / unit,
    )
    before = estimates(method, photons, points, normals)
    after = estimates(method, other, unit * points, normals, unit)
    np.testing.assert_allclose(after * unit / flux * unit, before, rtol=1e-6)


@pytest.mark.parametrize("method", NAMES)
def test_a_field_goes_with_its_last_user(method, patch):
    """Also if it was called: nothing it keeps refers to it."""
    photons, points, normals = patch
    made = field(method, photons.replace())
    made(points, normals)
    gone, light = weakref.ref(made), weakref.ref(made.photons)
    gc.disable()
    try:
        del made
        assert gone() is None
        assert light() is None
    finally:
        gc.enable()


@pytest.mark.parametrize("method", NAMES)
def test_the_order_of_photons_and_points_does_not_matter(method, patch):
    photons, points, normals = patch
    shuffled = photons.subset(np.random.default_rng(9).permutation(len(photons)))
    before = estimates(method, photons, points, normals)
    after = estimates(method, shuffled, points[::-1], normals)[::-1]
    np.testing.assert_allclose(after, before, rtol=1e-9)


@pytest.mark.parametrize("method", NAMES)
def test_same_bytes_for_every_number_of_threads(method, patch):
    one, *others = [estimates(method, *patch, n_threads=t).tobytes() for t in (1, 2, 7)]
    assert all(other == one for other in others)


@pytest.mark.parametrize("method", NAMES)
def test_densities_are_linear_in_what_photons_carry(method, patch):
    photons, points, normals = patch
    made = field(method, photons)
    values = np.random.default_rng(10).random((len(photons), 2))
    columns = np.hstack([photons.flux, values, values @ [[2.0], [-3.0]]])
    found = made.densities(columns)(points, normals)
    np.testing.assert_allclose(found[:, :3], made(points, normals), rtol=1e-12)
    np.testing.assert_allclose(found[:, 5:], found[:, 3:5] @ [[2.0], [-3.0]], atol=1e-9 * 3000)


@pytest.mark.parametrize("method", NAMES)
def test_surfaces_that_face_away_are_dark(method, patch):
    photons, points, normals = patch
    assert np.median(estimates(method, photons, points, normals)) > 0.5
    assert (estimates(method, photons, points, -normals) == 0.0).all()


@pytest.mark.parametrize("method", NAMES)
def test_an_empty_map_is_dark(method):
    empty = uniform_map(10, "random").subset([])
    points, normals = plane(np.array([[0.5, 0.5], [2.0, 2.0]]))
    made = field(method, empty)
    assert made(points, normals).tolist() == [[0.0, 0.0, 0.0]] * 2
    assert made.densities(np.empty((0, 5)))(points, normals).tolist() == [[0.0] * 5] * 2


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, pr.RelaxSettings((5, 5), step=2.0)),
        ({"relax": pr.RelaxSettings((2, 1))}, pr.RelaxSettings((2, 1))),
    ],
)
def test_mapped_relaxes_towards_the_rest_density(given, expected):
    photons = uniform_map(3000, "random").replace(path_signature=np.arange(3000) % 2)
    rest = pr.rest_density(photons)
    moved = pr.relax(photons, pr.detect_structure(photons), expected, rest=rest)
    made = pr.irradiance_field(photons, method="mapped", **given)
    assert made.photons.position.tobytes() == moved.position.tobytes()
    assert made.used["relax"] == asdict(expected)
    assert list(made.seconds) == ["structure", "rest_density", "relax"]


def test_methods_that_do_not_relax_have_no_relaxed_photons():
    inputs = MethodInput(uniform_map(10, "random"), Settings(), None, None, None)
    message = "should be one that relaxes photons, relaxation, parameterised, mapped, but is 'stan"
    with pytest.raises(ValueError, match=message):
        relaxed_photons("standard", inputs)


def test_arguments_that_are_none_are_named_with_those_that_would_do():
    expected = (
        "irradiance_field has no argument gatherr, n_thread; settings are structure, gradient, "
        "rest_density, relax, gather, diffusion, progressive, frequency, envelope"
    )
    with pytest.raises(TypeError) as caught:
        pr.irradiance_field(uniform_map(100, "halton"), gatherr=pr.GatherSettings(), n_thread=1)
    assert str(caught.value) == expected
