"""Structure: the statistics of SJ13 §4.3, and what sheets, edges and filaments look like."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.relaxation import structure as st
from tests.helpers.photon_maps import flat_map, uniform_map, unit_square


def uniform_disc(rng, n_sets, k):
    radius = np.sqrt(rng.random((n_sets, k)))
    angle = 2 * np.pi * rng.random((n_sets, k))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize(("k", "tolerances"), [(100, (5e-4, 3e-4)), (50, (5e-4, 3e-4))])
def test_second_eigenvalue_of_uniform_discs(k, tolerances):
    """SJ13 Fig. 7a: mean 0.2219 and deviation 0.0188 at k = 100."""
    offsets = uniform_disc(np.random.default_rng(0), 100_000, k)
    second = st.principal_components(offsets)[0][:, 1]
    assert second.mean() == pytest.approx(st.isotropic_mean(k), abs=tolerances[0])
    assert second.std() == pytest.approx(st.isotropic_sd(k), abs=tolerances[1])
    if k == 100:
        assert second.mean() == pytest.approx(0.2219, abs=5e-4)
        assert second.std() == pytest.approx(0.0188, abs=3e-4)


def test_the_papers_forms_agree_at_a_hundred():
    assert st.isotropic_mean(100) == pytest.approx(0.25 - 0.2809 / np.sqrt(100), abs=3e-4)
    assert st.isotropic_sd(100) == pytest.approx(0.188 / np.sqrt(100), abs=3e-5)


def test_principal_components_equal_numpys():
    offsets = np.random.default_rng(1).normal(size=(500, 12, 2)) @ np.array([[2, 1], [0, 0.5]])
    values, vectors = st.principal_components(offsets)
    for i, cloud in enumerate(offsets):
        expected, directions = np.linalg.eigh(np.cov(cloud.T, bias=True))
        np.testing.assert_allclose(values[i], expected[::-1], rtol=1e-12)
        assert abs(directions[:, 1] @ vectors[i]) == pytest.approx(1.0, abs=1e-12)


def test_where_the_constants_of_the_mapping_come_from():
    """1/4: variance of a full unit disc along an axis. 16/(9π²): squared mean of a half disc."""
    n = 2000
    r, a = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n * np.pi)
    mass = r / r.sum()
    y = r * np.sin(a)  # across the straight edge of the upper half disc
    mean_square, mean = (mass * y**2).sum(), (mass * y).sum()
    assert mean_square == pytest.approx(1 / 4, abs=1e-6)
    assert mean**2 == pytest.approx(16 / (9 * np.pi**2), abs=1e-6)
    edge = mean_square - mean**2
    assert 1 / st.anisotropy_to_gradient(edge) == pytest.approx(3 * np.pi / 4, abs=1e-5)


def test_mapping_is_clamped_and_monotone():
    eigenvalues = np.linspace(-0.1, 0.4, 301)
    mapped = np.array([st.anisotropy_to_gradient(x) for x in eigenvalues])
    assert (np.diff(mapped) <= 0).all()
    assert mapped[0] == mapped[100] == pytest.approx(4 / (3 * np.pi))
    assert mapped[-1] == 0.0
    assert st.anisotropy_to_gradient(0.2) == pytest.approx(np.sqrt(0.05))


def test_noise_attenuation_is_the_normal_tail():
    """SJ13 Eq. 6 by direct integration of the density."""
    k = 50
    mean, sd = st.isotropic_mean(k), st.isotropic_sd(k)
    x = np.linspace(mean - 8 * sd, mean + 8 * sd, 200_001)
    density = np.exp(-0.5 * ((x - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi))
    for eigenvalue in (mean - 2 * sd, mean, mean + sd):
        tail = np.trapezoid(np.where(x >= eigenvalue, density, 0.0), x)
        assert st.noise_attenuation(eigenvalue, k) == pytest.approx(tail, abs=1e-4)


def brute_force_neighbours(photons, i, k, reach):
    gap = np.linalg.norm(photons.emitter_coords - photons.emitter_coords[i], axis=1)
    candidates = np.flatnonzero(gap <= reach)
    distance = np.linalg.norm(photons.position[candidates] - photons.position[i], axis=1)
    order = np.argsort(distance, kind="stable")[:k]
    return candidates[order], distance[order]


def folded_map(n=4000):
    """A sheet folded over itself: x = (2u − 1)², two layers on the same ground."""
    uv = unit_square(n, "random", seed=5)
    return flat_map(np.column_stack([(2 * uv[:, 0] - 1) ** 2, uv[:, 1]]), n, coords=uv)


def test_structure_equals_its_definition():
    photons, k = folded_map(), 40
    settings = pr.StructureSettings(k=k, range_scale=2.0, reach_scale=np.inf)
    found = pr.detect_structure(photons, settings)
    reach = 2.0 * np.sqrt(k / (np.pi * len(photons)))
    np.testing.assert_allclose(found.emitter_range, reach)
    for i in range(0, len(photons), 97):
        ids, distance = brute_force_neighbours(photons, i, k, reach)
        values, vectors = np.linalg.eigh(np.cov(photons.position[ids, :2].T, bias=True))
        assert found.n_found[i] == len(ids)
        assert found.radius[i] == pytest.approx(distance[-1])
        np.testing.assert_allclose(
            found.eigenvalues[i], values[::-1] / distance[-1] ** 2, rtol=1e-9, atol=1e-15
        )
        assert found.constraint[i] == pytest.approx(
            st.constraint(found.eigenvalues[i, 1], len(ids))
        )
        assert abs(found.basis[i, 0, :2] @ vectors[:, 1]) == pytest.approx(1.0)
        assert found.basis[i, 1] @ photons.normal[i] == pytest.approx(0.0, abs=1e-15)


def test_emitter_range_keeps_the_edge_of_an_overlapped_sheet():
    """SJ13 Fig. 3: a sheet ends in the middle of another, whose photons would hide its edge."""
    n = 20_000
    ground, short = unit_square(n, "halton", 1), unit_square(n // 2, "halton", 2) * [0.5, 1]
    photons = flat_map(
        np.concatenate([ground, short]), n, coords=np.concatenate([ground, short + 5])
    )
    seen = pr.detect_structure(photons)
    blind = pr.detect_structure(photons.replace(emitter_coords=None, emitter_density=None))
    x, y = photons.position[:, 0], photons.position[:, 1]
    edge = (np.arange(len(photons)) >= n) & (x > 0.499) & (abs(y - 0.5) < 0.4)
    assert seen.constraint[edge].min() > 0.9
    assert blind.constraint[edge].mean() < 0.6


def test_an_edge_is_constrained_across_and_uniform_light_is_free():
    photons = uniform_map(50_000, "halton")
    found = pr.detect_structure(photons)
    x, y = photons.position[:, 0], photons.position[:, 1]
    edge = (x < 0.001) & (abs(y - 0.5) < 0.3)
    middle = (abs(x - 0.5) < 0.3) & (abs(y - 0.5) < 0.3)
    assert found.constraint[edge].min() > 0.95
    assert found.constraint[middle].mean() < 0.1
    np.testing.assert_allclose(np.abs(found.basis[edge][:, 1, 0]), 1.0, atol=0.05)


def test_independent_photons_are_mostly_free():
    """Noise alone: λ₂ scatters about µ_N, so the mean stays well under 1/2."""
    found = pr.detect_structure(uniform_map(50_000, "random"))
    assert found.constraint.mean() < 0.35


def test_a_filament_is_free_along_and_constrained_across():
    rng = np.random.default_rng(3)
    xy = np.column_stack([rng.random(3000), 1e-4 * rng.random(3000)])
    found = pr.detect_structure(
        flat_map(xy, 3000).replace(emitter_coords=None, emitter_density=None)
    )
    assert found.constraint.min() > 0.99
    np.testing.assert_allclose(np.abs(found.basis[:, 0, 0]), 1.0, atol=1e-2)


def test_emitters_never_mix():
    first, second = uniform_map(3000, "random", 1), uniform_map(2000, "random", 2)
    order = np.random.default_rng(0).permutation(5000)
    fields = ("position", "normal", "flux", "emitter_coords", "emitter_density")
    both = pr.PhotonMap(
        **{f: np.concatenate([getattr(first, f), getattr(second, f)])[order] for f in fields},
        emitter_id=np.repeat([0, 1], [3000, 2000])[order],
    )
    apart = [pr.detect_structure(m).eigenvalues for m in (first, second)]
    np.testing.assert_array_equal(
        pr.detect_structure(both).eigenvalues, np.concatenate(apart)[order]
    )


@pytest.mark.parametrize("scale", [1e-30, 1e-4, 1e4, 1e30])
def test_structure_does_not_depend_on_the_unit_of_length(scale):
    photons = folded_map(2000)
    larger = photons.replace(position=photons.position * scale)
    a, b = pr.detect_structure(photons), pr.detect_structure(larger)
    np.testing.assert_allclose(b.eigenvalues, a.eigenvalues, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(b.radius, a.radius * scale, rtol=1e-12)


def test_coincident_and_lonely_photons_have_no_structure():
    coincident = pr.detect_structure(flat_map(np.full((60, 2), 0.3), 60))
    assert (coincident.constraint == 0.0).all()
    assert (coincident.eigenvalues == 0.0).all()
    lonely = pr.detect_structure(flat_map(np.array([[0.1, 0.1], [0.9, 0.9]]), 10**6))
    np.testing.assert_array_equal(lonely.n_found, [1, 1])
    assert (lonely.constraint == 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(lonely.basis, axis=2), 1.0)
    assert len(pr.detect_structure(flat_map(np.empty((0, 2)), 1))) == 0


def test_same_bytes_for_every_number_of_threads():
    photons = folded_map(20_000)
    one, *others = [pr.detect_structure(photons, n_threads=t) for t in (1, 2, 7)]
    for other in others:
        for field in ("eigenvalues", "constraint", "basis", "radius", "n_found"):
            assert getattr(one, field).tobytes() == getattr(other, field).tobytes()


def test_coordinates_and_density_come_together():
    photons = folded_map(100)
    with pytest.raises(ValueError, match="emitter_coords but no emitter_density"):
        pr.detect_structure(photons.replace(emitter_density=None))
    with pytest.raises(ValueError, match="emitter_density but no emitter_coords"):
        pr.detect_structure(photons.replace(emitter_coords=None))
    with pytest.raises(ValueError, match="emitter_density should be positive"):
        pr.detect_structure(photons.replace(emitter_density=np.zeros(100)))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"k": 3}, "k should be at least 4"),
        ({"range_scale": 0.0}, "range_scale should be a pos"),
        ({"range_scale": np.inf}, "range_scale should be a pos"),
    ],
)
def test_bad_settings_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        pr.StructureSettings(**fields)


def test_neighbours_in_range_but_out_of_reach_do_not_count():
    """A sparse sheet under a dense one: its photons see no farther than three dense radii."""
    dense, sparse = unit_square(20_000, "random", 1), unit_square(200, "random", 2)
    coords = np.concatenate([dense, sparse * 0.1 + 5])  # as far apart at the emitter as the dense
    photons = flat_map(np.concatenate([dense, sparse]), 20_000, coords=coords)
    found = pr.detect_structure(photons)
    world = pr.KDTree(photons.position).query_self(50).distance[:, -1]
    np.testing.assert_allclose(found.reach, 3.0 * world)
    assert (found.radius <= found.reach).all()
    assert found.n_found[20_000:].mean() < 25
    assert (found.n_found[:20_000] == 50).mean() > 0.95
    free = pr.detect_structure(photons, pr.StructureSettings(reach_scale=np.inf))
    assert (free.n_found[20_000:] == 50).all()


@pytest.mark.parametrize("coords", [True, False])
def test_the_two_sides_of_a_plate_are_no_neighbours(coords):
    top, below = uniform_map(4000, "random", 1), uniform_map(4000, "random", 2)
    below = below.replace(normal=-below.normal)
    fields = ["position", "normal", "flux"]
    if coords:
        fields += ["emitter_coords", "emitter_density"]
    plate = pr.PhotonMap(
        **{f: np.concatenate([getattr(top, f), getattr(below, f)]) for f in fields}
    )
    alone = [
        pr.detect_structure(pr.PhotonMap(**{f: getattr(m, f) for f in fields}))
        for m in (top, below)
    ]
    found = pr.detect_structure(plate)
    np.testing.assert_array_equal(found.eigenvalues, np.concatenate([a.eigenvalues for a in alone]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"basis": np.zeros((1, 2, 3))}, r"basis should have shape \(100, 2, 3\)"),
        ({"constraint": np.full(100, 5.0)}, "constraint should lie in"),
        ({"radius": np.full(100, np.nan)}, "radius should be finite"),
        ({"n_found": np.zeros(100, dtype=int)}, "n_found should count the photon itself"),
    ],
)
def test_a_structure_is_checked(change, message):
    found = pr.detect_structure(folded_map(100))
    with pytest.raises(ValueError, match=message):
        pr.Structure(**{**vars(found), **change})


def test_fewer_than_four_photons_have_no_structure():
    for n, known in ((3, False), (4, True)):
        found = pr.detect_structure(flat_map(unit_square(n, "random"), 1))
        assert (found.eigenvalues > 0.0).all() == known
