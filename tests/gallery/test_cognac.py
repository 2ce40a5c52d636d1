"""The glass of cognac: smooth curves, finer where they bend, and normals of the exact surface."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.gallery.solids import Curve
from photonrelax.scene.shading import given_normals

CORNERS = [(1.0, 0.0), (0.9, 0.4), (0.4, 0.9), (0.0, 1.0)]


def glass_and_liquid(scale):
    return pr.gallery.scene("cognac", sections=16, rings=32 * scale).objects[1:]


def bends(mesh, sections=16):
    """Angles, rad, between facets of the profile in the plane y = 0."""
    rings = np.asarray(mesh.vertices)[:-2:sections][:, [0, 2]]
    profile = np.concatenate(
        [mesh.vertices[-2:-1][:, [0, 2]], rings, mesh.vertices[-1:][:, [0, 2]]]
    )
    steps = np.diff(profile, axis=0)
    return np.abs(np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))))


def test_the_glass_has_no_kinks():
    """Twice the facets turn by half the angle, everywhere."""
    coarse, fine = (bends(glass_and_liquid(scale)[0].mesh).max() for scale in (4, 8))
    assert fine < 0.6 * coarse < np.radians(10.0)


@pytest.mark.parametrize("number", [0, 1], ids=["glass", "liquid"])
def test_normals_are_those_of_the_surface(number):
    """They differ from means over facets by less, the smaller the facets."""
    most = []
    for sections in (64, 128):
        mesh = (
            pr.gallery.scene("cognac", sections=sections, rings=sections).objects[1 + number].mesh
        )
        normals = given_normals(mesh)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
        facets = np.asarray(mesh.face_normals)
        cosine = np.einsum("fki,fi->fk", normals[mesh.faces], facets)
        seen = np.ones(len(facets), bool)
        if number == 1:
            # The edge of the liquid's surface is a crease, within the glass.
            below = np.unique(mesh.faces[facets[:, 2] < 0.9])
            seen = ~np.isin(mesh.faces, below).any(axis=1)
        most.append(np.arccos(np.clip(cosine[seen].min(), -1.0, 1.0)))
    assert most[1] < 0.7 * most[0] < np.radians(20.0)


def test_steps_of_a_curve_are_even_in_length_and_bends():
    curve = Curve.through(CORNERS, (0.0, 1.0), (-1.0, 0.0))
    points, normals = curve.even(200, 0.5)
    steps = np.diff(points, axis=0)
    length = np.linalg.norm(steps, axis=1)
    turned = np.linalg.norm(np.diff(normals, axis=0), axis=1)
    np.testing.assert_allclose(length + 0.5 * turned, np.mean(length + 0.5 * turned), rtol=0.02)
    np.testing.assert_allclose(normals[[0, -1]], [[1.0, 0.0], [0.0, 1.0]], atol=1e-12)
    middle = 0.5 * (normals[1:] + normals[:-1])
    np.testing.assert_allclose(np.einsum("ij,ij->i", middle, steps) / length, 0.0, atol=1e-4)
