"""Memory of renders: estimated before the work, refused where it does not suffice."""

import re

import pytest

import photonrelax as pr
from photonrelax.cli import main
from photonrelax.rendering.budget import check_render_fits, memory_limit
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


@pytest.mark.parametrize(("size", "code"), [("8G", 0), ("1k", 1), ("0", 2), ("x", 2), ("", 2)])
def test_memory_on_the_command_line(tmp_path, size, code, capsys):
    command = ["render", "ring", "-o", str(tmp_path / "ring.exr"), "--width", "8", "--quiet"]
    try:
        found = main([*command, "--photons", "1000", "--memory", size])
    except SystemExit as usage:
        found = usage.code
    assert found == code
    assert "memory" in capsys.readouterr().err or code == 0
