"""Irradiance maps: means over texels of rectangles."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.estimation import irradiance_map as module
from tests.helpers.photon_maps import flat_map, uniform_map, unit_square

CORNER, U, V = (0.2, 0.3, 0.0), (0.5, 0.0, 0.0), (0.0, 0.4, 0.0)


@pytest.fixture(scope="module")
def field():
    """Light that falls off towards x = 1, of three colours, on the unit square."""
    position = unit_square(50_000, "random")
    photons = flat_map(position, 1)
    colour = np.array([1.0, 2.0, 3.0]) / len(position)
    return pr.irradiance_field(
        photons.replace(flux=2.0 * (1.0 - position[:, :1]) * colour), method="standard"
    )


def counts(field, corner, width, height, shape):
    """Flux of the photons in each texel, over its area."""
    position, flux = field.photons.position, field.photons.flux
    nx, ny = shape
    edges = (
        corner[1] + height * np.arange(ny + 1) / ny,
        corner[0] + width * np.arange(nx + 1) / nx,
    )
    sums = [
        np.histogram2d(position[:, 1], position[:, 0], bins=edges, weights=f)[0] for f in flux.T
    ]
    return np.stack(sums, axis=-1) / (width * height / (nx * ny))


def test_wide_texels_hold_the_flux_within_them(field):
    """Their rims of some photon spacings apart."""
    image = pr.irradiance_map(field, CORNER, U, V, (5, 4))
    assert image.shape == (4, 5, 3)
    expected = counts(field, CORNER, 0.5, 0.4, (5, 4))
    np.testing.assert_allclose(image, expected, rtol=0.05)
    # Light falls off along u: columns run along u, rows along v.
    assert (np.diff(image, axis=1) < 0.0).all()


def test_texels_are_where_they_are_said_to_be(field):
    image = pr.irradiance_map(field, CORNER, U, V, (5, 4))
    row, column = 3, 1
    centre = np.array(CORNER) + np.multiply(U, 1.5 / 5) + np.multiply(V, 3.5 / 4)
    edges = [[np.divide(U, 5), np.divide(V, 4)]]
    one = field([centre], [[0.0, 0.0, 1.0]], footprint=edges)
    np.testing.assert_allclose(image[row, column], one[0], rtol=1e-12)


def test_sides_may_run_either_way(field):
    """Turning both sides turns the image by half a turn, swapping them transposes it."""
    image = pr.irradiance_map(field, CORNER, U, V, (5, 4))
    far = np.add(np.add(CORNER, U), V)
    turned = pr.irradiance_map(field, far, np.negative(U), np.negative(V), (5, 4))
    np.testing.assert_allclose(turned[::-1, ::-1], image, rtol=1e-9)
    swapped = pr.irradiance_map(field, CORNER, V, U, (4, 5), normal=(0, 0, 1))
    np.testing.assert_allclose(swapped.transpose(1, 0, 2), image, rtol=1e-9)


def test_light_comes_from_the_side_of_the_normal(field):
    lit = pr.irradiance_map(field, CORNER, U, V, (3, 3))
    assert (lit > 0.0).all()
    # u × v is the default; any vector on that side is the same.
    same = pr.irradiance_map(field, CORNER, U, V, (3, 3), normal=(0.5, 0.5, 0.1))
    np.testing.assert_array_equal(same, lit)
    for dark in (
        pr.irradiance_map(field, CORNER, U, V, (3, 3), normal=(0, 0, -2)),
        pr.irradiance_map(field, CORNER, V, U, (3, 3)),
    ):
        np.testing.assert_array_equal(dark, 0.0)


def test_all_flux_of_a_surface_is_in_its_map():
    """Beyond its edges, too: kernels reach over them by a spacing of photons."""
    photons = uniform_map(20_000, "halton")
    image = pr.irradiance_map(
        pr.irradiance_field(photons, method="standard"),
        *((-0.2, -0.2, 0.0), (1.4, 0, 0), (0, 1.4, 0), (64, 64)),
    )
    flux = image.sum(axis=(0, 1)) * (1.4 / 64) ** 2
    np.testing.assert_allclose(flux, photons.flux.sum(axis=0), rtol=0.01)


def test_bands_and_executors_change_no_bit(field, monkeypatch):
    whole = pr.irradiance_map(field, CORNER, U, V, (7, 9))
    monkeypatch.setattr(module, "_TEXELS_PER_BAND", 14)
    np.testing.assert_array_equal(pr.irradiance_map(field, CORNER, U, V, (7, 9)), whole)
    with ThreadPoolExecutor(2) as executor:
        again = pr.irradiance_map(field, CORNER, U, V, (7, 9), executor=executor)
    np.testing.assert_array_equal(again, whole)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"u": (0, 0, 0)}, "u should be a side of the map, m, but is zero"),
        ({"v": (0, 0, 0)}, "v should be a side"),
        ({"v": (0.1, 1, 0)}, "the angle between them is 84.2894 degrees"),
        ({"v": (1, 0, 0)}, "u and v should be perpendicular"),
        ({"origin": (0, 0)}, "origin"),
        ({"origin": (0, np.nan, 0)}, "origin"),
        ({"shape": (0, 3)}, "nx"),
        ({"shape": (3, 2.5)}, "ny"),
        ({"shape": 3}, "two numbers of texels"),
        ({"normal": (1, 2, 0)}, "normal should be on a side of the map"),
        ({"normal": (0, 0, 0)}, "normal"),
    ],
)
def test_errors_name_the_argument(field, change, message):
    given = {"origin": CORNER, "u": U, "v": V, "shape": (3, 3)} | change
    options = {"normal": given.pop("normal")} if "normal" in given else {}
    with pytest.raises((ValueError, TypeError), match=message):
        pr.irradiance_map(field, *given.values(), **options)
