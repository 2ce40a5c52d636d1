"""Bytes per photon that each stage allocates at most, its input not counted."""

import sys
import tracemalloc

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.estimation.diffusion import DiffusionField
from tests.helpers.photon_maps import flat_map, unit_square

N = 60_000
# While a tree of so many axes is built: the points, the tree with its boxes, and the order of its
# leaves with two tables of keys, which are all that grows with the number of axes.
BUILDING = {3: 85, 5: 170, 6: 187, 8: 254}
STRUCTURE, POSITION = 100, 24
# Room to search for 500, which does not grow with photons (2.3 MB); flux and gradients, in blocks
# too.
SEARCHING, CARRIED = 40, 64


def flat(**fields):
    return flat_map(unit_square(N, "random"), N, **fields)


def curved():
    """Photons of so many normals that all are searched in one tree."""
    photons = flat()
    slope = 0.2 * photons.position[:, :2]
    return photons.replace(normal=np.column_stack([slope, np.ones(N)]))


def of_two_emitters():
    return flat(emitter_id=np.arange(N) % 10 // 9)


def allocated(work):
    """Return the result and the most bytes per photon that were allocated at a time."""
    tracemalloc.start()
    result = work()
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return result, most / N


@pytest.mark.parametrize(
    ("photons", "n_axes", "n_axes_to_gather"),
    [(flat, 5, 3), (of_two_emitters, 5, 3), (curved, 8, 6)],
    ids=["flat", "of two emitters", "curved"],
)
def test_a_stage_takes_what_it_returns_and_one_tree(photons, n_axes, n_axes_to_gather):
    photons = photons()
    pr.irradiance_field(photons.subset(slice(0, 100)))  # what is made only once stays out of it
    structure, detecting = allocated(lambda: pr.detect_structure(photons, n_threads=1))
    relaxed, moving = allocated(lambda: pr.relax(photons, structure, n_threads=1))
    _, preparing = allocated(lambda: pr.IrradianceField(relaxed, n_threads=1))
    assert detecting < STRUCTURE + BUILDING[n_axes]
    assert moving < POSITION + BUILDING[n_axes]
    assert preparing < BUILDING[n_axes_to_gather]


@pytest.mark.parametrize(("photons", "n_axes"), [(flat, 3), (curved, 6)])
def test_gathering_many_takes_room_for_one_search_a_thread(photons, n_axes):
    """Though ten thousand are made for the radius. Diffusion also what it knows of photons."""
    photons, gather = photons(), pr.GatherSettings(k=500)
    DiffusionField(photons.subset(slice(0, 600)))
    _, gathering = allocated(lambda: pr.IrradianceField(photons, gather, n_threads=1))
    settings = pr.DiffusionSettings(k=500, normalisation="maximum")
    _, diffusing = allocated(lambda: DiffusionField(photons, settings, n_threads=1))
    assert gathering < BUILDING[n_axes] + SEARCHING
    assert diffusing < BUILDING[n_axes] + SEARCHING + CARRIED


@pytest.mark.parametrize("left_over", [0, 5, 16, 17])
def test_photons_are_projected_some_at_a_time(left_over, monkeypatch):
    scene = gallery.scene("sphere", subdivisions=4)
    photons = pr.trace_photons(scene, 3000).subset(slice(0, 20 * 64 + left_over))
    structure = pr.detect_structure(photons)
    settings = pr.RelaxSettings(n_iterations=(1, 1))
    whole = pr.relax(photons, structure, settings, scene=scene)
    monkeypatch.setattr(sys.modules["photonrelax.relaxation.relax"], "_PROJECTION_CHUNK", 64)
    parts = pr.relax(photons, structure, settings, scene=scene)
    assert parts.position.tobytes() == whole.position.tobytes()
    assert parts.normal.tobytes() == whole.normal.tobytes()
