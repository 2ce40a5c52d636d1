"""Memory of renders: estimated before the work, refused where it does not suffice."""

import re

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.cli import main
from photonrelax.rendering.budget import (
    check_map_fits,
    check_render_fits,
    memory_limit,
    rays_within,
)
from photonrelax.rendering.view import View


def test_what_fits_is_rendered(ring):
    assert pr.render(ring, n_emitted=2000, memory=1e9).layers["radiance"].any()


def test_nine_tenths_of_what_is_free_may_be_taken(monkeypatch):
    monkeypatch.setattr("photonrelax.rendering.budget.available_memory", lambda: 10e9)
    assert memory_limit(None) == 9e9
    assert memory_limit(3e9) == 3e9


def test_too_many_photons_are_refused_with_a_number_that_fits(ring):
    with pytest.raises(MemoryError, match=r"about .* but memory is 1 GB: emit at most") as refused:
        pr.render(ring, n_emitted=10**8, memory=1e9)
    fits = int(re.search(r"at most ([\d,]+)", str(refused.value))[1].replace(",", ""))
    view = View(ring)
    check_render_fits(view, {"caustic": fits}, 1e9)
    with pytest.raises(MemoryError):
        check_render_fits(view, {"caustic": int(1.1 * fits)}, 1e9)


def test_too_large_an_image_is_refused(ring):
    with pytest.raises(MemoryError, match="make the image smaller"):
        pr.render(ring, n_emitted=1000, memory=1e8)


def test_methods_without_photons_need_no_memory_for_them(ring):
    assert pr.render(ring, method="envelope", n_emitted=10**8, memory=1e9).layers["caustic"].any()


def test_photons_that_are_given_are_counted_without_their_place(ring):
    view = View(ring)
    check_render_fits(view, {}, 2e9, n_given=10**6)
    with pytest.raises(MemoryError, match=r"10,000,000 photons given about 4.04 GB .* \(photons\)"):
        check_render_fits(view, {}, 2e9, n_given=10**7)
    photons = pr.trace_photons(ring, 2000)
    with pytest.raises(MemoryError, match=f"{len(photons):,} photons given"):
        pr.render(ring, photons=photons, memory=1e6)


def test_rays_of_envelopes_that_are_asked_for_are_counted(ring):
    with pytest.raises(MemoryError, match=r"envelope of 1,000,000 rays .*: trace at most [\d,]+"):
        pr.render(ring, method="envelope", memory=2e9, envelope=pr.EnvelopeSettings(n_rays=10**6))
    # An error ends them long before.
    settings = pr.EnvelopeSettings(n_rays=10**6, error=0.1)
    assert pr.render(ring, method="envelope", memory=1e9, envelope=settings)


def test_envelopes_take_no_more_rays_than_fit(ring):
    settings = pr.EnvelopeSettings(error=2e-3)

    def rays(memory):
        image = pr.render(ring, method="envelope", memory=memory, envelope=settings)
        return image.stats["envelope"]["rays"]

    fits = rays_within(View(ring), None, 3e8)
    assert rays(3e8) <= fits < rays(8e9)
    with pytest.raises(MemoryError, match=r"envelope of 20,000 rays .*: trace at most [\d,]+"):
        rays(2.5e8)


def test_scenes_count_by_their_triangles():
    coarse, fine = (View(pr.gallery.scene("ring", pixels=8, sections=n)) for n in (64, 2048))
    n_triangles = [
        sum(len(each.mesh.faces) for each in view.scene.objects) for view in (coarse, fine)
    ]
    fits = [rays_within(view, None, 1e9) for view in (coarse, fine)]
    assert (fits[0] - fits[1]) * 3600 == pytest.approx(400 * np.diff(n_triangles)[0], rel=0.01)


def test_maps_are_refused_with_numbers_that_fit(ring):
    check_map_fits(ring, 1000, 64, 1e9)
    with pytest.raises(MemoryError, match="take fewer texels"):
        check_map_fits(ring, 1000, 10_000, 1e9)
    with pytest.raises(MemoryError, match=r"emit at most") as refused:
        check_map_fits(ring, 10**8, 64, 1e9)
    fits = int(re.search(r"at most ([\d,]+)", str(refused.value))[1].replace(",", ""))
    check_map_fits(ring, fits, 64, 1e9)
    with pytest.raises(MemoryError):
        check_map_fits(ring, int(1.1 * fits), 64, 1e9)


def test_memory_of_a_map_on_the_command_line(tmp_path, capsys):
    command = ["irradiance", "ring", "--on", "floor", "-o", str(tmp_path / "map.exr"), "--quiet"]
    sizes = ["--photons", "1000", "--texels", "16"]
    assert main([*command, *sizes, "--memory", "1G"]) == 0
    assert main([*command, *sizes, "--memory", "1M"]) == 1
    assert "but memory is 1 MB" in capsys.readouterr().err


@pytest.mark.parametrize(("size", "code"), [("8G", 0), ("1k", 1), ("0", 2), ("x", 2), ("", 2)])
def test_memory_on_the_command_line(tmp_path, size, code, capsys):
    command = ["render", "ring", "-o", str(tmp_path / "ring.exr"), "--width", "8", "--quiet"]
    try:
        found = main([*command, "--photons", "1000", "--memory", size])
    except SystemExit as usage:
        found = usage.code
    assert found == code
    assert "memory" in capsys.readouterr().err or code == 0
