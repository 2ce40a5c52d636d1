"""Gradients: known densities, edges, noise, and the original relaxation that uses them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import photonrelax as pr
from photonrelax.photons.axes import MAX_FACES
from photonrelax.relaxation.gradient import gradient_constraint
from tests.helpers.photon_maps import flat_map, plane, uniform_map, unit_square


def found_gradient(photons, **settings):
    """Constraints as vectors (n, 3) up the gradient, and the structure."""
    found = pr.detect_gradient(photons, pr.GradientSettings(**settings))
    return found.constraint[:, np.newaxis] * found.basis[:, 1], found


def ramp(n, kind):
    """E = 2x over the unit square, by inversion: x = √u."""
    uv = unit_square(n, kind)
    return flat_map(np.column_stack([np.sqrt(uv[:, 0]), uv[:, 1]]), n, coords=uv)


def inside(photons, margin):
    return (np.abs(photons.position[:, :2] - 0.5) < 0.5 - margin).all(axis=1)


def test_gradients_equal_their_definition():
    photons, k, gain = ramp(3000, "random"), 30, 1.7
    found = pr.detect_gradient(photons, pr.GradientSettings(k=k, gain=gain))
    neighbours = pr.KDTree(photons.position).query_self(k)
    for i in range(0, 3000, 37):
        offset = (photons.position[neighbours.ids[i]] - photons.position[i])[:, :2]
        radius = neighbours.distance[i, -1]
        shift = offset.mean(axis=0) / radius
        length = np.linalg.norm(shift)
        assert found.radius[i] == pytest.approx(radius)
        assert found.n_found[i] == k
        assert found.constraint[i] == pytest.approx(min(1, gain * 0.75 * np.pi * length))
        np.testing.assert_allclose(found.basis[i, 1, :2], shift / length, atol=1e-9)
        np.testing.assert_allclose(found.basis[i] @ found.basis[i].T, np.eye(2), atol=1e-12)
        values = np.linalg.eigvalsh(np.cov(offset.T, bias=True)) / radius**2
        np.testing.assert_allclose(found.eigenvalues[i], values[::-1], rtol=1e-9)


@pytest.mark.parametrize("kind", ["random", "halton"])
def test_the_gradient_of_a_linear_field(kind):
    """m = r ∇E / (4 E), here r / (4 x), on the mean over photons, whose noise has none."""
    photons = ramp(100_000, kind)
    gradient, found = found_gradient(photons, k=200)
    middle = inside(photons, 0.2)
    expected = 0.75 * np.pi * found.radius / (4 * photons.position[:, 0])
    ratio = gradient[middle].mean(axis=0) / expected[middle].mean()
    np.testing.assert_allclose(ratio, [1.0, 0.0, 0.0], atol=0.04)


@pytest.mark.parametrize("k", [16, 50])
def test_a_straight_edge_constrains_fully(k):
    """Half discs at x = 0; half the gain, so that no constraint is cut off at one.

    The k photons are the one at the edge, one on the rim at 2/π of the radius on the mean, and
    k - 2 whose mean is 4/(3π): together 1 - 1/(2k) of the latter.
    """
    photons = flat_map(np.tile([0.2, 1], 1) * unit_square(100_000, "random"), 100_000)
    x, y = photons.position[:, 0], photons.position[:, 1]
    edge = (x < 1e-4) & (np.abs(y - 0.5) < 0.45)
    gradient, _ = found_gradient(photons, k=k, gain=0.5)
    assert edge.sum() > 40
    assert 2 * gradient[edge, 0].mean() == pytest.approx(1 - 0.5 / k, abs=0.06)
    full = pr.detect_gradient(photons, pr.GradientSettings(k=k, gain=2.0))
    assert (full.constraint[edge] == 1.0).mean() > 0.9
    assert gradient_constraint(4 / (3 * np.pi), 1.0) == pytest.approx(1.0)


@pytest.mark.parametrize("k", [16, 50, 200])
def test_noise_in_uniform_light(k):
    """Independent photons: mean square (3π/4)²/(2k), mean 1.48/√k, no direction preferred."""
    photons = uniform_map(60_000, "random")
    gradient, found = found_gradient(photons, k=k, gain=0.5)
    middle = inside(photons, 0.1)
    square = (0.5 * 0.75 * np.pi) ** 2 / (2 * k)
    assert (found.constraint[middle] ** 2).mean() == pytest.approx(square, rel=0.04)
    assert found.constraint[middle].mean() == pytest.approx(0.5 * 1.477 / np.sqrt(k), rel=0.03)
    assert np.abs(gradient[middle].mean(axis=0)).max() < 0.05 * np.sqrt(square)


def test_gradients_turn_with_the_scene():
    photons = ramp(4000, "random")
    turn = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix().T
    turned = photons.replace(position=photons.position @ turn, normal=photons.normal @ turn)
    before, _ = found_gradient(photons)
    after, _ = found_gradient(turned)
    np.testing.assert_allclose(after, before @ turn, atol=1e-9)


def test_photons_of_other_emitters_and_faces_are_no_neighbours():
    first, second, third = (uniform_map(3000, "random", seed) for seed in range(3))
    fields = ("position", "normal", "flux")
    apart = [pr.PhotonMap(**{f: getattr(m, f) for f in fields}) for m in (first, second, third)]
    apart[2] = apart[2].replace(normal=-apart[2].normal)
    order = np.random.default_rng(0).permutation(9000)
    together = pr.PhotonMap(
        **{f: np.concatenate([getattr(m, f) for m in apart])[order] for f in fields},
        emitter_id=np.repeat([0, 1, 0], 3000)[order],
    )
    alone = np.concatenate([pr.detect_gradient(m).constraint for m in apart])
    np.testing.assert_array_equal(pr.detect_gradient(together).constraint, alone[order])


def bent(xy, radius, side):
    """Photons on one side of a cylinder about the y axis, each with a normal of its own."""
    angle = 0.5 * (xy[:, 0] - 0.5)
    across = np.column_stack([np.sin(angle), np.zeros(len(xy)), np.cos(angle)])
    along = xy[:, 1:] * [[0.0, 1.0, 0.0]]
    return pr.PhotonMap(radius * across + along, side * across, np.ones(len(xy)))


def test_photons_on_the_two_sides_of_a_curved_sheet_are_no_neighbours():
    """Light on one side ends at an edge, that on the other does not."""
    one = bent(unit_square(3000, "random", 0), 2.0, 1.0)
    other = bent(unit_square(3000, "random", 1) * [1.0, 0.5], 2.0 - 1e-3, -1.0)
    both = pr.PhotonMap(
        **{
            field: np.concatenate([getattr(one, field), getattr(other, field)])
            for field in ("position", "normal", "flux")
        }
    )
    assert len(np.unique(one.normal, axis=0)) > MAX_FACES
    alone = [found_gradient(side)[0] for side in (one, other)]
    np.testing.assert_allclose(found_gradient(both)[0], np.concatenate(alone), atol=1e-12)


def test_coincident_and_lonely_photons_are_free():
    for xy in (np.full((60, 2), 0.3), np.array([[0.1, 0.1], [0.9, 0.9]]), np.empty((0, 2))):
        found = pr.detect_gradient(flat_map(xy, 60))
        assert (found.constraint == 0.0).all()
        assert len(found) == len(xy)


def test_same_bytes_for_every_number_of_threads():
    photons = ramp(20_000, "random")
    one, *others = [pr.detect_gradient(photons, n_threads=t) for t in (1, 2, 7)]
    for other in others:
        for field in ("eigenvalues", "constraint", "basis", "radius", "n_found"):
            assert getattr(one, field).tobytes() == getattr(other, field).tobytes()


def test_the_method_is_the_gradient_and_iterations_in_space(interior):
    """As many as are asked for in both spaces, 14 by default."""
    photons = uniform_map(5000, "random")
    found = pr.detect_gradient(photons)
    relaxed = pr.relax(photons, found, pr.RelaxSettings((0, 14)))
    expected = pr.estimate_irradiance(relaxed, *interior)
    for settings in ({}, {"relax": pr.RelaxSettings((3, 11))}):
        field = pr.irradiance_field(photons, method="relaxation", **settings)
        np.testing.assert_array_equal(field(*interior), expected)
        assert field.used["relax"]["n_iterations"] == (0, 14)
        assert field.used["gradient"] == {"k": 50, "gain": 1.0}
    with pytest.raises(ValueError, match="iterations in emitter space need both or neither"):
        pr.relax(photons, found, pr.RelaxSettings((7, 7)))


def test_gain_keeps_edges_and_noise():
    """SJ13 §3, measured: more gain blurs a step less, and leaves more noise in uniform light."""
    n = 40_000
    left, right = unit_square(n, "random", 1), unit_square(n // 4, "random", 2)
    xy = np.concatenate([left * [0.5, 1], right * [0.5, 1] + [0.5, 0]])
    photons = flat_map(xy, n)
    rng = np.random.default_rng(0)
    sample = {"near": 0.5 + rng.uniform(-0.01, 0.01, 8000), "far": rng.uniform(0.1, 0.4, 8000)}
    bias, noise = [], []
    for gain in (0.5, 4.0):
        gradient = pr.GradientSettings(gain=gain)
        field = pr.irradiance_field(photons, method="relaxation", gradient=gradient)
        errors = {}
        for place, x in sample.items():
            points, normals = plane(np.column_stack([x, rng.uniform(0.1, 0.9, len(x))]))
            errors[place] = field(points, normals)[:, 0] - np.where(x < 0.5, 2.0, 0.5)
        sign = np.where(sample["near"] < 0.5, 1.0, -1.0)
        bias.append(-(sign * errors["near"]).mean())
        noise.append(errors["far"].std())
    assert bias[1] < 0.8 * bias[0]
    assert noise[1] > 1.5 * noise[0]


@pytest.mark.parametrize(
    ("fields", "message"),
    [({"k": 3}, "k should be at least 4"), ({"gain": 0.0}, "gain should be a positive number")],
)
def test_bad_settings_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        pr.GradientSettings(**fields)
