from decimal import Decimal, localcontext

import numpy as np
import pytest

from photonrelax.transport.optics import beer_lambert, fresnel, reflect, refract

INDICES = [
    (1.0, 1.5),
    (1.5, 1.0),
    (1.0, 1.0),
    (1.33, 1.33),
    (1.0, 1.0 + 1e-9),
    (1.0, 2.4),
    (2.4, 1),
]
# From head-on to grazing, down to a 1e-9 from the surface.
COSINES = np.concatenate([np.linspace(0.0, 1.0, 1001), np.geomspace(1e-9, 1e-2, 50)])


def rays_at(cos_i):
    """Directions with the given cosines of incidence on a surface whose normal is z."""
    return np.column_stack([np.sqrt((1 - cos_i) * (1 + cos_i)), np.zeros_like(cos_i), -cos_i])


def normals(n):
    return np.tile([0.0, 0.0, 1.0], (n, 1))


def textbook(cos_i, n1, n2):
    """Fresnel's unpolarised reflectance and transmittance, computed with fifty digits."""
    with localcontext(prec=50):
        c, n1, n2 = Decimal(cos_i), Decimal(n1), Decimal(n2)
        cos2_t = 1 - (n1 / n2) ** 2 * (1 - c * c)
        if cos2_t < 0:
            return 1.0, 0.0
        t = cos2_t.sqrt()
        s, p = n1 * c + n2 * t, n2 * c + n1 * t
        reflected = (((n1 * c - n2 * t) / s) ** 2 + ((n2 * c - n1 * t) / p) ** 2) / 2
        transmitted = n2 * t / (n1 * c) * ((2 * n1 * c / s) ** 2 + (2 * n1 * c / p) ** 2) / 2
        return float(reflected), float(transmitted)


@pytest.mark.parametrize(("n1", "n2"), INDICES)
def test_reflected_plus_transmitted_is_one_at_every_angle(n1, n2):
    cos_i = COSINES[COSINES > 0.0]
    transmitted = np.array([textbook(c, n1, n2)[1] for c in cos_i])
    np.testing.assert_allclose(fresnel(cos_i, n1, n2) + transmitted, 1.0, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("n1", "n2"), INDICES)
def test_fresnel_equals_the_textbook_form(n1, n2):
    cos_i = COSINES[COSINES > 0.0]
    expected = [textbook(c, n1, n2)[0] for c in cos_i]
    np.testing.assert_allclose(fresnel(cos_i, n1, n2), expected, rtol=1e-12, atol=1e-30)


def test_fresnel_head_on_at_grazing_and_at_brewsters_angle():
    assert fresnel(1.0, 1.0, 1.5) == pytest.approx(0.04, rel=1e-14)
    assert fresnel(0.0, 1.0, 1.5) == pytest.approx(1.0, rel=1e-14)
    assert fresnel(1e-9, 1.0, 1.5) == pytest.approx(1.0, abs=1e-7)
    # At tan(angle) = n2/n1 the p part vanishes and r_s is (n1² - n2²)/(n1² + n2²).
    brewster = np.cos(np.arctan(1.5))
    assert fresnel(brewster, 1.0, 1.5) == pytest.approx(0.5 * (1.25 / 3.25) ** 2, rel=1e-14)


def test_equal_indices_let_everything_pass_straight_on():
    np.testing.assert_array_equal(fresnel(COSINES, 1.33, 1.33), 0.0)
    rays = rays_at(COSINES)
    out, ok = refract(rays, normals(len(rays)), 1.33, 1.33)
    assert ok.all()
    np.testing.assert_allclose(out, rays, rtol=0, atol=1e-15)


def test_nearly_equal_indices_keep_their_digits():
    # Head-on, R is ((n1 - n2)/(n1 + n2))²: 2.5e-17 here, with n2 - n1 = 1e-8 in binary.
    n2 = 1.0 + 1e-8
    assert fresnel(1.0, 1.0, n2) == pytest.approx(((n2 - 1.0) / (n2 + 1.0)) ** 2, rel=1e-14)


def test_total_reflection_starts_at_the_critical_angle():
    critical = np.sqrt(1.0 - 1.0 / 1.5**2)
    cos_i = np.array([0.0, 0.5 * critical, critical * (1 - 1e-12), critical * (1 + 1e-12), 1.0])
    _, ok = refract(rays_at(cos_i), normals(5), 1.5, 1.0)
    np.testing.assert_array_equal(ok, [False, False, False, True, True])
    reflectance = fresnel(cos_i, 1.5, 1.0)
    np.testing.assert_array_equal(reflectance[:3], 1.0)
    assert (reflectance[3:] < 1.0).all()
    out, _ = refract(rays_at(cos_i), normals(5), 1.5, 1.0)
    assert np.isnan(out[:3]).all()


@pytest.mark.parametrize(("n1", "n2"), INDICES)
def test_snell(n1, n2):
    rays = rays_at(COSINES)
    out, ok = refract(rays, normals(len(rays)), n1, n2)
    sin_i, sin_t = rays[:, 0], np.hypot(out[:, 0], out[:, 1])
    np.testing.assert_array_equal(ok, n1 / n2 * sin_i <= 1.0)
    np.testing.assert_allclose(n2 * sin_t[ok], n1 * sin_i[ok], rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(out[ok], axis=1), 1.0, rtol=1e-15, atol=0)
    assert (out[ok, 2] <= 0.0).all()
    assert not out[ok, 1].any()


def test_reflection_keeps_the_tangent_and_turns_the_normal_part():
    rng = np.random.default_rng(3)
    rays, axes = rng.normal(size=(2, 100, 3))
    out = reflect(rays, axes)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    mirror = np.eye(3) - 2.0 * axes[:, :, None] * axes[:, None, :]
    np.testing.assert_allclose(out, np.einsum("nij,nj->ni", mirror, rays), rtol=0, atol=1e-15)


def test_refraction_is_reversible():
    rng = np.random.default_rng(4)
    rays = rng.normal(size=(100, 3))
    rays[:, 2] = -np.abs(rays[:, 2])
    inside, ok = refract(rays, normals(100), 1.0, 1.5)
    assert ok.all()
    back, ok = refract(inside, normals(100), 1.5, 1.0)
    assert ok.all()
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    np.testing.assert_allclose(back, rays, rtol=0, atol=1e-12)


def test_beer_lambert():
    distance = np.array([0.0, 0.5, 1.0, 1e6])
    out = beer_lambert([0.0, 1.0, 2.0], distance)
    np.testing.assert_array_equal(out[:, 0], 1.0)
    np.testing.assert_allclose(out[:, 1], np.e**-distance, rtol=1e-15)
    # Twice the thickness squares the transmittance.
    np.testing.assert_allclose(out[2], out[1] ** 2, rtol=1e-15)
    rows = beer_lambert(np.tile([0.0, 1.0, 2.0], (4, 1)), distance)
    np.testing.assert_array_equal(rows, out)


def test_threads_change_nothing():
    rays, axes = rays_at(COSINES), normals(len(COSINES))
    for n_threads in (2, 7):
        assert np.array_equal(
            fresnel(COSINES, 1.0, 1.5, n_threads=1), fresnel(COSINES, 1.0, 1.5, n_threads=n_threads)
        )
        one, many = (refract(rays, axes, 1.0, 1.5, n_threads=n)[0] for n in (1, n_threads))
        assert one.tobytes() == many.tobytes()


def test_shapes_broadcast_and_may_be_empty():
    assert fresnel(np.ones((2, 3)), 1.0, [1.3, 1.4, 1.5]).shape == (2, 3)
    assert fresnel(0.5, 1.0, 1.5).shape == ()
    assert reflect(np.empty((0, 3)), np.empty((0, 3))).shape == (0, 3)
    assert beer_lambert([1, 1, 1], []).shape == (0, 3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fresnel(1.1, 1.0, 1.5), r"cos_i should lie in \[0, 1\], but one is 1.1"),
        (lambda: fresnel(-0.1, 1.0, 1.5), r"cos_i should lie in \[0, 1\], but one is -0.1"),
        (lambda: fresnel(0.5, 0.0, 1.5), "n1 should be positive"),
        (lambda: fresnel(np.nan, 1.0, 1.5), "cos_i should be finite"),
        (lambda: reflect([[0, 0, 0]], [[0, 0, 1]]), "direction should hold directions"),
        (lambda: reflect([[0, 0, 1]], [0, 0, 1]), "normal should have shape"),
        (lambda: refract([[0, 0, 1]], [[0, 0, 1]], 1, 2), "normal should face against direction"),
        (lambda: refract([[0, 0, -1]], [[0, 0, 1]], 1, -2), "n2 should be positive"),
        (lambda: beer_lambert([1, -1, 1], [1.0]), "absorption should not be negative"),
        (lambda: beer_lambert([1, 1], [1.0]), "absorption should have shape"),
        (lambda: beer_lambert([1, 1, 1], [-1.0]), "distance should not be negative"),
    ],
)
def test_errors_name_the_argument(call, message):
    with pytest.raises(ValueError, match=message):
        call()
