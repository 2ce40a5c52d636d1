"""White light that is dispersed: Snell's law by wavelength, colours, and the ledger."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.scene.dispersion import LONGEST, N_WAVELENGTHS, SHORTEST

FLINT = pr.Abbe(1.7, 30.0)
SLANTED = pr.CollimatedEmitter((0.6, 0.0, -0.8), (3.0, 2.0, 1.0))
THICKNESS, HEIGHT = 0.5, 1.0


def block(size, at, material):
    mesh = trimesh.creation.box(size, trimesh.transformations.translation_matrix(at))
    return pr.SceneObject(mesh, material)


FLOOR = block((9.0, 9.0, 0.2), (0.0, 0.0, -0.1), pr.Diffuse())
GAUGE = block((9.0, 9.0, 0.0), (0.0, 0.0, 2.0), pr.Sensor())


def plate(ior, *others, emitter=SLANTED, **of_glass):
    glass = block((3.0, 3.0, THICKNESS), (0, 0, HEIGHT), pr.Dielectric(ior, **of_glass))
    return pr.Scene([glass, FLOOR, *others], [emitter])


@pytest.fixture(scope="module")
def photons():
    return pr.trace_photons(plate(FLINT), 20_000)


def test_photons_lie_where_snells_law_takes_their_wavelength(photons):
    """Light straight through a plate is displaced by the index of its wavelength."""
    through = photons.subset((photons.n_bounces == 2) & (photons.position[:, 0] > 0.0))
    sine = 0.6 / FLINT.index(through.wavelength)
    # On the emitter's plane, whose middle looks at that of the plate, up the plate is along y.
    within = THICKNESS * sine / np.sqrt(1.0 - sine**2)
    starts = through.position[:, 0] - within - 0.75 * (HEIGHT - THICKNESS / 2)
    across = through.emitter_coords
    axes = np.linalg.lstsq(np.column_stack([across, np.ones(len(across))]), starts, rcond=None)[0]
    np.testing.assert_allclose(
        np.column_stack([across, np.ones(len(across))]) @ axes, starts, atol=1e-6
    )
    # And not where that of any one index does.
    assert np.ptp(within) > 0.005


def test_every_path_has_stratified_wavelengths_that_turn(photons):
    share = (photons.wavelength - SHORTEST) / (LONGEST - SHORTEST) * N_WAVELENGTHS
    _, path, number = np.unique(
        photons.emitter_coords, axis=0, return_inverse=True, return_counts=True
    )
    of_whole = np.lexsort((share, path))[number[np.sort(path)] == N_WAVELENGTHS]
    stratum, turn = np.divmod(share[of_whole].reshape(-1, N_WAVELENGTHS), 1.0)
    assert (stratum == np.arange(N_WAVELENGTHS)).all()
    np.testing.assert_allclose(turn, np.broadcast_to(turn[:, :1], turn.shape), atol=1e-9)
    np.testing.assert_allclose(np.sort(turn[:, 0]), np.linspace(0.0, 1.0, len(turn)), atol=0.01)


def test_white_light_stays_white():
    """The wavelengths of a photon's light are together white, and of the emitter's colour."""
    nearly_plain = pr.trace_photons(plate(pr.Abbe(1.5, 1e6)), 20_000)
    plain = pr.trace_photons(plate(1.5), 20_000)
    flux, expected = nearly_plain.flux.sum(axis=0), plain.flux.sum(axis=0)
    np.testing.assert_allclose(flux, expected, rtol=2e-3)
    # Of the photons some are more saturated than sRGB has colours.
    assert (nearly_plain.flux.min(axis=1) < 0.0).any()


@pytest.mark.parametrize("paths", ["caustic", "global", "all"])
@pytest.mark.parametrize("absorption", [0.0, (0.1, 1.0, 3.0)])
def test_the_ledger_balances(paths, absorption):
    scene = plate(FLINT, absorption=absorption)
    photons = pr.trace_photons(scene, 5000, paths=paths)
    ledger = photons.ledger
    assert ledger.imbalance < 1e-9
    assert sum(int(number.sum()) for number in ledger.ends.values()) == 5000
    if paths == "caustic":
        np.testing.assert_allclose(ledger.stored[0], photons.flux.sum(axis=0), rtol=1e-12)


def test_photons_do_not_depend_on_batches_and_threads(photons):
    again = pr.trace_photons(plate(FLINT), 20_000, batch_size=1024, n_threads=1)
    for name in ("position", "flux", "wavelength"):
        np.testing.assert_array_equal(getattr(again, name), getattr(photons, name))
    np.testing.assert_array_equal(again.ledger.discarded, photons.ledger.discarded)


def test_light_that_meets_no_dispersive_surface_stays_white():
    mirror = block((1.0, 1.0, 0.1), (3.0, 0.0, 0.5), pr.Mirror())
    photons = pr.trace_photons(plate(FLINT, mirror), 5000)
    white = photons.wavelength == 0.0
    np.testing.assert_allclose(photons.flux[white] / photons.flux[white][0], 1.0)
    assert white.any()
    assert not white.all()
    far = [block((1.0, 1.0, 0.1), (0, 0, -5.0), pr.Dielectric(FLINT))]
    assert pr.trace_photons(pr.Scene([FLOOR, mirror, *far], [SLANTED]), 500).wavelength is None


def test_a_sensor_stores_light_once_before_it_is_dispersed():
    """The irradiance that comes down is that of the light before, on any side of the glass."""
    photons = pr.trace_photons(plate(FLINT, GAUGE), 40_000, paths="all")
    on_gauge = photons.subset(photons.on_sensor & (photons.wi[:, 2] > 0.0))
    assert not on_gauge.wavelength.any()
    plain = pr.trace_photons(plate(FLINT.index_d, GAUGE), 40_000, paths="all")
    expected = plain.subset(plain.on_sensor & (plain.wi[:, 2] > 0.0))
    np.testing.assert_array_equal(on_gauge.position, expected.position)


def test_spectra_and_envelopes_are_refused():
    with pytest.raises(ValueError, match="frequency_share should be 0 in a scene with dispersion"):
        pr.trace_photons(plate(FLINT), 1000, frequency_share=0.1)
    with pytest.raises(ValueError, match="no dispersion for method='envelope'"):
        pr.trace_envelope(plate(FLINT))
