"""Vector instructions: which are used, and that results are the same bits whichever they are."""

import platform
from pathlib import Path

import numpy as np
import pytest

import photonrelax as pr
from photonrelax._ext.spatial import tree as kdtree
from photonrelax._util import progress
from tests.estimation import test_nearest as test_estimate
from tests.helpers import simd_paths
from tests.helpers.photon_maps import flat_map, unit_square
from tests.relaxation import test_relax, test_structure

NEEDED = {
    "avx512": {"avx512f", "avx512bw", "avx512dq", "avx512vl", "popcnt", "bmi1"},
    "avx2": {"avx2", "popcnt", "bmi1"},
    "portable": set(),
}
on_each_path = simd_paths.each("path")
CPUINFO = Path("/proc/cpuinfo")


def flags():
    """Instruction sets that the processor reports."""
    lines = CPUINFO.read_text().splitlines()
    return set(next((line for line in lines if line.startswith("flags")), "").split())


@pytest.mark.skipif(
    platform.machine() != "x86_64" or not CPUINFO.exists(), reason="no flags of an x86 to read"
)
def test_the_widest_the_processor_has_is_used(monkeypatch):
    present = [path for path, needed in NEEDED.items() if needed <= flags()]
    for variable in ("", None):
        monkeypatch.delenv(simd_paths.VARIABLE, raising=False)
        if variable is not None:
            monkeypatch.setenv(simd_paths.VARIABLE, variable)
        assert kdtree.instruction_set() == present[0]
    for path in NEEDED.keys() - present:
        with simd_paths.forced(path), pytest.raises(ValueError, match="processor should have it"):
            pr.KDTree(np.zeros((3, 3)))
    assert [path for path in NEEDED if simd_paths.has(path)] == present


@on_each_path
def test_the_environment_chooses(path):
    with simd_paths.forced(path):
        assert kdtree.instruction_set() == path


@pytest.mark.parametrize("path", ["sse2", "AVX2", "avx", "avx2 ", "1"])
def test_other_names_are_refused_when_a_tree_is_built(path):
    message = "PHOTONRELAX_SIMD should be avx512, avx2 or portable.* but is '" + path
    tree = pr.KDTree(np.zeros((3, 3)))
    with simd_paths.forced(path):
        for build in (kdtree.instruction_set, lambda: pr.KDTree(np.zeros((3, 3)))):
            with pytest.raises(ValueError, match=message):
                build()
        # A tree keeps what it was built with.
        np.testing.assert_array_equal(tree.query_self(1).ids[:, 0], [0, 0, 0])


# Definitions of other files, path by path


@on_each_path
def test_structure_equals_its_definition(path):
    with simd_paths.forced(path):
        test_structure.test_structure_equals_its_definition()


@on_each_path
@pytest.mark.parametrize("stage", ["constrained", "collapsed"])
def test_one_iteration_equals_its_definition(path, stage):
    with simd_paths.forced(path):
        test_relax.test_one_iteration_equals_its_definition(stage)


@on_each_path
@pytest.mark.parametrize("kernel", test_estimate.KERNELS)
def test_estimates_equal_their_definition(path, kernel):
    with simd_paths.forced(path):
        test_estimate.test_estimates_equal_their_definition(kernel, 0.03)


# The same bits


def folded(n=5000):
    """Light folded over itself, with a bright spot, a gap and photons at the same point."""
    uv = unit_square(n, "random", seed=7)
    xy = np.column_stack([(2 * uv[:, 0] - 1) ** 2, uv[:, 1]])
    xy[: n // 5] = 0.4 + 1e-3 * xy[: n // 5]
    xy[n // 5 : n // 4] = xy[0]
    return flat_map(xy, n, coords=uv)


def on_a_ball(n=3000):
    """Photons on a curved surface, from a point emitter: nine axes."""
    rng = np.random.default_rng(8)
    normal = rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    directions = normal * [1, 1, 0.1]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return pr.PhotonMap(
        normal,
        normal,
        rng.random((n, 3)),
        emitter_coords=directions,
        emitter_density=np.full(n, n / (4 * np.pi)),
        n_emitted=n,
    )


def folded_at(scale, offset=0.0):
    photons = folded()
    return photons.replace(position=scale * photons.position + offset)


MAPS = {
    "folded": folded,
    "ball": on_a_ball,
    "tiny": lambda: folded_at(1e-140),
    "huge": lambda: folded_at(1e120),
    "far away": lambda: folded_at(1.0, 1e6),
}


def bits(photons, n_threads=2):
    """Return all that searches lead to, as bytes."""
    tree = pr.KDTree(np.hstack([photons.position, photons.emitter_coords]), n_threads=n_threads)
    found = tree.query_self(30, range_radius=0.2, exclude_self=True, n_threads=n_threads)
    structure = pr.detect_structure(photons, n_threads=n_threads)
    settings = pr.RelaxSettings(n_iterations=(2, 2))
    relaxed = pr.relax(photons, structure, settings, n_threads=n_threads)
    rows = np.random.default_rng(9).permutation(len(photons))[:1000]
    irradiance = pr.estimate_irradiance(
        relaxed, photons.position[rows], photons.normal[rows], n_threads=n_threads
    )
    arrays = {
        "ids": found.ids,
        "distance": found.distance,
        "farthest": tree.farthest(70, n_threads=n_threads),
        "eigenvalues": structure.eigenvalues,
        "constraint": structure.constraint,
        "basis": structure.basis,
        "radius": structure.radius,
        "n_found": structure.n_found,
        "relaxed": relaxed.position,
        "irradiance": irradiance,
    }
    return {name: array.tobytes() for name, array in arrays.items()}


def differing(one, other):
    return [name for name in one if one[name] != other[name]]


@pytest.fixture(scope="module", params=MAPS)
def portable(request):
    """A map and what the portable path makes of it."""
    photons = MAPS[request.param]()
    with simd_paths.forced("portable"):
        return photons, bits(photons)


@on_each_path
def test_paths_give_the_same_bits(path, portable):
    photons, expected = portable
    with simd_paths.forced(path):
        assert differing(bits(photons), expected) == []


@pytest.mark.kernels_run_elsewhere
@on_each_path
@pytest.mark.parametrize("n_threads", [1, 7])
def test_numbers_of_threads_and_of_rows_at_a_time_give_the_same_bits(
    path, n_threads, portable, monkeypatch
):
    photons, expected = portable
    monkeypatch.setattr(progress, "CHUNK", 48 * n_threads)
    with simd_paths.forced(path):
        assert differing(bits(photons, n_threads), expected) == []


@on_each_path
def test_the_order_of_queries_does_not_matter(path):
    rng = np.random.default_rng(10)
    photons = folded()
    points = np.column_stack([rng.random((2000, 2)) ** 3, np.zeros(2000)])
    normals = np.tile([0.0, 0.0, 1.0], (2000, 1))
    shuffled = rng.permutation(2000)
    with simd_paths.forced(path):
        field = pr.irradiance_field(photons, method="standard")
        tree = pr.KDTree(photons.position)
        irradiance, found = field(points, normals), tree.query(points, 20)
        again = tree.query(points[shuffled], 20)
        np.testing.assert_array_equal(
            field(points[shuffled], normals[shuffled]), irradiance[shuffled]
        )
        np.testing.assert_array_equal(again.ids, found.ids[shuffled])
        np.testing.assert_array_equal(again.distance, found.distance[shuffled])
        # One at a time, and a number that fills no batch.
        for n in (1, 19):
            np.testing.assert_array_equal(field(points[:n], normals[:n]), irradiance[:n])
            np.testing.assert_array_equal(tree.query(points[:n], 20).ids, found.ids[:n])
