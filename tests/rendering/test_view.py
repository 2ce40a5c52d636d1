"""Views that keep their hit points, so that images of other photons need not trace them again."""

from dataclasses import replace

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.rendering import view as view_module
from photonrelax.rendering.layers import fixed_layers
from photonrelax.rendering.view import View, resized


@pytest.fixture
def sunlit(ring):
    """The ring with a wide sun, whose direct light is sampled."""
    sun = pr.CollimatedEmitter(direction=(0.5, 0.0, -1.0), angular_radius=20.0)
    return replace(ring, emitters=(*ring.emitters, sun))


def traces_of(view, monkeypatch, *, bands, seeds=(0, 1)):
    """Layers of the view with some seeds, and how often bands of it were traced."""
    calls = []
    trace = view_module.trace_hit_points
    monkeypatch.setattr(
        view_module, "trace_hit_points", lambda *a, **k: calls.append(a) or trace(*a, **k)
    )
    layers = [fixed_layers([view.variant(seed=seed).band(b) for b in bands]) for seed in seeds]
    monkeypatch.undo()
    return layers, len(calls)


def test_images_of_kept_hit_points_have_the_same_bits(sunlit, monkeypatch):
    fresh, kept = View(sunlit), View(sunlit)
    kept.keep_bands(1e9)
    bands = fresh.row_ranges(3)
    expected, n_fresh = traces_of(fresh, monkeypatch, bands=bands)
    found, n_kept = traces_of(kept, monkeypatch, bands=bands)
    assert (n_fresh, n_kept) == (2 * len(bands), len(bands))
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.keys() == theirs.keys()
        for name, values in ours.items():
            np.testing.assert_array_equal(values, theirs[name])
    # Shadow rays are those of the seed.
    assert (found[0]["direct"] != found[1]["direct"]).any()


def test_direct_light_is_that_of_three_seeds_in_turns(sunlit):
    view = View(sunlit)
    view.keep_bands(1e9)
    (rows,) = view.row_ranges()
    direct = [view.variant(seed=seed).band(rows).direct for seed in (5, 6, 7, 8, 6)]
    assert (direct[0] != direct[1]).any()
    assert (direct[1] != direct[2]).any()
    assert direct[3] is direct[0]
    assert direct[4] is direct[1]


def test_direct_light_is_left_out_of_kept_hit_points_where_it_is_not_wanted(ring):
    view = View(ring)
    view.keep_bands(1e9)
    (rows,) = view.row_ranges()
    assert view.band(rows).direct is not None
    assert view.band(rows, direct=False).direct is None


def test_hit_points_that_take_too_much_are_not_kept(ring, monkeypatch):
    view = View(ring)
    view.keep_bands(1000.0)
    assert view.kept_bytes == 0.0
    assert traces_of(view, monkeypatch, bands=view.row_ranges())[1] == 2


def test_samples_elsewhere_are_traced_anew(ring):
    view = View(ring)
    view.keep_bands(1e9)
    (rows,) = view.row_ranges()
    centre, corner = view.band(rows), view.band(rows, (0.1, 0.1))
    assert (centre.hits.position[:10] != corner.hits.position[:10]).any()
    np.testing.assert_array_equal(
        corner.hits.position, View(ring).band(rows, (0.1, 0.1)).hits.position
    )


def test_a_scene_without_a_camera_is_resized_to_nothing_else():
    scene = replace(gallery.scene("ring"), camera=None)
    assert resized(scene, None, None) is scene
    with pytest.raises(ValueError, match="camera to be resized"):
        resized(scene, 40, None)
