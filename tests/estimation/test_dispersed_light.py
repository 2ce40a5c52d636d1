"""Light of many wavelengths: white where they overlap, as even as light of one index."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.estimation.methods import PHOTON_METHODS
from photonrelax.estimation.split_passes import assign_passes
from photonrelax.photons.neighbourhoods import neighbour_groups, spectrum_parts
from photonrelax.scene.dispersion import N_WAVELENGTHS
from photonrelax.scene.sky_map import LUMINANCE

CROWN = pr.Abbe(1.5168, 64.17)
N_PATHS = 6000
SIDE = 1.6 / 24
METHODS = [name for name in PHOTON_METHODS if name != "frequency"]


def behind_plate(ior):
    """Photons of slanted white light behind a thin plate."""
    plate = trimesh.creation.box(
        (3.0, 3.0, 0.02), trimesh.transformations.translation_matrix((0, 0, 0.3))
    )
    floor = trimesh.creation.box(
        (6.0, 6.0, 0.1), trimesh.transformations.translation_matrix((0, 0, -0.05))
    )
    scene = pr.Scene(
        [pr.SceneObject(plate, pr.Dielectric(ior)), pr.SceneObject(floor, pr.Diffuse())],
        [pr.CollimatedEmitter((0.5, 0.2, -1.0))],
    )
    return pr.trace_photons(scene, N_PATHS)


@pytest.fixture(scope="module")
def dispersed():
    return behind_plate(CROWN)


@pytest.fixture(scope="module")
def plain():
    return behind_plate(CROWN.index_d)


def irradiance(photons, method):
    """Means over the cells of a square in the middle of the light."""
    x, y = np.meshgrid(np.arange(-12, 12) * SIDE + 0.15, np.arange(-12, 12) * SIDE)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    field = pr.irradiance_field(photons, method=method)
    return field(
        points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), footprint=np.full(len(points), SIDE)
    )


def noise_of_colour(values):
    chromaticity = values / (values @ LUMINANCE)[:, np.newaxis]
    return np.sqrt(np.mean((chromaticity / chromaticity.mean(axis=0) - 1.0) ** 2))


def noise_of_luminance(values):
    luminance = values @ LUMINANCE
    return luminance.std() / luminance.mean()


def test_photons_are_neighbours_within_a_part_of_the_spectrum(dispersed):
    """Each part has the photons of white light, one of each path."""
    groups = neighbour_groups(dispersed, 2)
    numbers = [np.unique(spectrum_parts(dispersed)[group.rows]) for group in groups]
    assert sorted(np.concatenate(numbers)) == list(range(N_WAVELENGTHS))
    sizes = [len(group.rows) for group in groups]
    assert max(sizes) < 1.01 * min(sizes)
    assert dispersed.photons_per_path == N_WAVELENGTHS
    assert dispersed.counted(15) == 15 * N_WAVELENGTHS


def test_white_light_is_a_part_of_its_own(dispersed):
    wavelength = np.where(np.arange(len(dispersed)) % 2, 0.0, dispersed.wavelength)
    mixed = dispersed.replace(wavelength=wavelength, flux=np.ones(len(dispersed)))
    assert (spectrum_parts(mixed) == -1).sum() == len(mixed) // 2
    assert 1.0 < mixed.photons_per_path < 2.0
    assert mixed.replace(n_wavelengths=None).photons_per_path == 1.0


def test_passes_have_photons_of_all_parts(dispersed):
    number, part = assign_passes(dispersed, 4), spectrum_parts(dispersed)
    counts = np.histogram2d(number, part, [4, N_WAVELENGTHS])[0]
    assert counts.max() - counts.min() < 0.02 * counts.min()


def test_wavelengths_of_a_path_are_in_one_pass(dispersed):
    """Discs of passes differ in size, and light would be coloured."""
    number = assign_passes(dispersed, 4)
    _, path = np.unique(dispersed.emitter_coords, axis=0, return_inverse=True)
    first = np.full(path.max() + 1, -1)
    first[path] = number
    np.testing.assert_array_equal(first[path], number)
    assert noise_of_colour(irradiance(dispersed, "progressive")) < 0.012


def test_colour_is_even_and_luminance_as_without_dispersion(dispersed, plain):
    """In cells that hold little more than the photons of a path."""
    coloured, white = (irradiance(photons, "mapped") for photons in (dispersed, plain))
    assert noise_of_colour(coloured) < 0.01
    assert noise_of_luminance(coloured) < 1.05 * noise_of_luminance(white)
    np.testing.assert_allclose(coloured.mean(axis=0), white.mean(axis=0), rtol=5e-3)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("method", METHODS)
def test_every_method_estimates_light_of_many_wavelengths(method, dispersed, plain):
    coloured, white = (irradiance(photons, method) for photons in (dispersed, plain))
    np.testing.assert_allclose(coloured.mean(axis=0), white.mean(axis=0), rtol=0.01)


def test_a_map_of_others_has_a_wavelength_a_path(dispersed):
    """Photons of random wavelengths, one of each path, are one part."""
    some = dispersed.subset(np.arange(len(dispersed)) % N_WAVELENGTHS == 3).replace(
        n_wavelengths=None
    )
    assert len(neighbour_groups(some, 1)) == 1
    assert irradiance(some, "parameterised").shape == (576, 3)
