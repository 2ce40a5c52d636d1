"""The photon pattern `shapes`: photons, exact pixels, and what SSO08 claims of diffusion on it."""

import numpy as np
import pytest
from bench.studies import shapes as figure4

import photonrelax as pr
from photonrelax import gallery
from photonrelax.estimation.methods import PHOTON_METHODS


@pytest.fixture(scope="module", params=["random", "halton"])
def shapes(request):
    return gallery.pattern("shapes", sampler=request.param, irradiance=2.0)


def test_the_gallery_lists_it_apart_from_scenes():
    assert "shapes" in gallery.pattern_names()
    assert "shapes" not in gallery.names()
    assert "disc" in gallery.about("shapes")
    with pytest.raises(
        ValueError, match="photon pattern should be one of shapes, two-sets, but is 'ring'"
    ):
        gallery.pattern("ring")
    with pytest.raises(ValueError, match="scene should be one of box"):
        gallery.scene("shapes")


def test_photons_lie_within_the_shapes_and_carry_their_light(shapes):
    photons = shapes.photons
    assert len(photons) == 48_000
    assert (shapes.irradiance(photons.position) == 2.0).all()
    flux = photons.flux.sum(axis=0)
    np.testing.assert_allclose(flux, shapes.pixel_means(50, 70).mean(axis=(0, 1)), rtol=1e-9)
    assert photons.well_spaced == (photons.sampler == "halton")


def test_photons_are_equally_dense_everywhere(shapes):
    """Counts in pixels of 2.5 cm over the expected ones: χ² of independent photons, or less."""
    side, photons = 40, shapes.photons
    row = side - 1 - (photons.position[:, 1] * side).astype(int)
    column = (photons.position[:, 0] * side).astype(int)
    found = np.bincount(row * side + column, minlength=side**2)
    expected = shapes.pixel_means(side, side)[..., 0].ravel() / side**2 / photons.flux[0, 0]
    lit = expected > 5.0
    squares = ((found - expected)[lit] ** 2 / expected[lit]).sum() / lit.sum()
    assert lit.sum() > 300
    assert squares < (0.5 if photons.well_spaced else 1.15)
    if not photons.well_spaced:
        assert squares > 0.85


def test_pixel_means_equal_many_samples_of_the_irradiance(shapes):
    exact = shapes.pixel_means(37, 23)
    sampled = shapes.image(lambda points, normals: shapes.irradiance(points), 37, 23, 20)
    # A border through a pixel of s·s samples is off by up to about 1/s.
    np.testing.assert_allclose(sampled, exact, atol=2.0 / 20)
    assert np.abs(sampled - exact).mean() < 3e-3


def test_pixel_means_add_up():
    """An image of half the size is the mean of four pixels."""
    shapes = gallery.pattern("shapes", n=10)
    fine = shapes.pixel_means(60, 40).reshape(20, 2, 30, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(fine, shapes.pixel_means(30, 20), atol=1e-12)


def test_lines_have_the_widths_asked_for():
    """By their areas: each is 0.84 m long from left to right and rises by 0.15 m."""
    length = np.hypot(0.84, 0.15)

    def areas(widths):
        made = gallery.pattern("shapes", n=1, line_widths=widths)
        rows = made.pixel_means(1, 100)[:, 0, 0] / 100
        return rows[45:].sum()

    assert areas((0.01, 0.02, 0.04)) == pytest.approx(length * 0.07)
    assert areas((0.03, 0.03, 0.03)) == pytest.approx(length * 0.09)


def test_images_are_the_right_way_up():
    shapes = gallery.pattern("shapes", n=1)
    xy = shapes.samples(2, 2)[0][:, :2]
    np.testing.assert_allclose(xy, [[0.25, 0.75], [0.75, 0.75], [0.25, 0.25], [0.75, 0.25]])


def test_seeds_and_samplers():
    position = [
        gallery.pattern("shapes", n=50, seed=s).photons.position.tobytes() for s in (0, 0, 1)
    ]
    assert position[0] == position[1] != position[2]
    with pytest.raises(ValueError, match="sampler should be random or halton, but is 'sobol'"):
        gallery.pattern("shapes", sampler="sobol")
    with pytest.raises(ValueError, match=r"line_widths should lie in \(0, 0.08\]"):
        gallery.pattern("shapes", line_widths=(0.0, 0.02, 0.04))


def test_every_method_takes_its_photons():
    """All but the one that needs spectra, which only traced photons have."""
    shapes = gallery.pattern("shapes", n=2000)
    points, normals = shapes.samples(9, 9)
    for method in set(PHOTON_METHODS) - {"frequency"}:
        field = pr.irradiance_field(shapes.photons, method=method)
        assert np.isfinite(field(points, normals)).all()


@pytest.fixture(scope="module")
def diffused():
    """Estimates of SSO08's diffusion, q = 0.1, from three maps: anisotropic, and isotropic."""
    return [figure4.measured(figure4.diffusion(0.1, isotropic=i), 3) for i in (False, True)]


def test_diffusion_keeps_more_of_the_thinnest_line_than_standard_estimates_as_quiet(diffused):
    """76 %; with bias compensation 52 %, with other standard estimates less than a third.

    Each kind goes from quieter to noisier, or it is noisier at any number of photons.
    """
    anisotropic, _ = diffused
    assert anisotropic.line > 0.7
    kinds = {
        "nearest": [figure4.nearest(k, gather_radius=0.1) for k in (850, 500)],
        "fixed": [figure4.nearest(10**6, gather_radius=h) for h in (0.036, 0.026)],
        "bias-compensation": [
            figure4.nearest(k, refinement="bias-compensation", gather_radius=0.1)
            for k in (2400, 600)
        ],
    }
    for kind, ways in kinds.items():
        quiet, noisy = (figure4.measured(way, 3) for way in ways)
        assert quiet.noise < 1.1 * anisotropic.noise < 1.2 * noisy.noise
        assert max(quiet.line, noisy.line) < (0.6 if kind == "bias-compensation" else 0.35)


def test_anisotropic_kernels_are_quieter_along_edges_than_isotropic(diffused):
    """8 % against 13 %, and on the line 14 % against 24 %; they keep as much of the line."""
    anisotropic, isotropic = diffused
    assert anisotropic.edge_noise < 0.7 * isotropic.edge_noise
    assert anisotropic.line_noise < 0.7 * isotropic.line_noise
    assert anisotropic.line == pytest.approx(isotropic.line, rel=0.05)


def test_regions_are_where_they_should_be():
    exact = gallery.pattern("shapes", n=1).irradiance
    for name, points in figure4.regions().items():
        for turn in np.linspace(0, 2 * np.pi, 8, endpoint=False):
            away = {"deep": 0.059, "edges": 0.0, "line": 0.0}[name]
            moved = points + away * np.array([np.cos(turn), np.sin(turn)])
            lit = exact(np.column_stack([moved, np.zeros(len(moved))]))
            assert (lit == 1.0).all(), name
