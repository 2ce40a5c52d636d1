"""Numbers beyond what integers or memory hold: refused in words, before the work begins."""

from dataclasses import replace

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax._util import memory, validation
from photonrelax.cli import commands
from photonrelax.evaluation import ComparisonRequest, gallery_subject
from photonrelax.evaluation.reference import ReferenceSettings, check_computable
from photonrelax.rendering import view
from photonrelax.spatial.kdtree import KDTree
from photonrelax.transport import trace
from photonrelax.transport.sampling import halton

HUGE = ("1e19", "18446744073709551616", "1e30", "1e308", "9" * 400)
SMALL = ("--width", "12", "--height", "12", "--supersampling", "1", "--quiet")
RENDER, COMPARE = ("render", "ring", "-o", "a.exr"), ("compare", "shapes", "-o", "c")
PASSES = (*RENDER, "--method", "progressive", "--passes", "2")
COUNTS = (
    *((RENDER, name) for name in ("photons", "width", "height", "supersampling", "k")),
    *((RENDER, "threads"), (PASSES, "passes"), (PASSES, "photons"), (COMPARE, "photons")),
    *((COMPARE, "width"), (("compare", "ring", "-o", "c"), "reference-photons")),
    (("compare", "ring", "-o", "c"), "reference-passes"),
    (("trace", "ring", "-o", "a.npz"), "photons"),
    (("trace", "ring", "-o", "a.npz"), "threads"),
)


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """One line on standard error, and no tracing."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(trace, "_trace_all", lambda *_: pytest.fail("tracing began"))

    def refused(*arguments):
        assert commands.main(arguments) == 1
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1
        assert len(err) < 400
        return err

    return refused


@pytest.mark.parametrize("number", HUGE, ids=lambda number: number[:20])
@pytest.mark.parametrize(("command", "name"), COUNTS)
def test_every_count_on_the_command_line_has_a_ceiling(command, name, number, refused):
    quick = ("--quiet",) if command[0] == "trace" else SMALL
    assert "should be" in refused(*command, *quick, f"--{name}", number)


@pytest.mark.parametrize("number", HUGE[1:], ids=lambda number: number[:20])
def test_the_seed_has_64_bits(number, refused):
    assert "seed should be below 2^64" in refused(*RENDER, *SMALL, "--seed", number)


@pytest.mark.parametrize("number", HUGE[1:], ids=lambda number: number[:20])
@pytest.mark.parametrize(
    ("method", "setting"),
    [
        ("parameterised", "structure.k"),
        ("parameterised", "relax.k"),
        ("relaxation", "gradient.k"),
        ("standard", "gather.k_min"),
        ("diffusion", "diffusion.k"),
        ("progressive", "progressive.n_passes"),
    ],
)
def test_every_setting_has_a_ceiling(method, setting, number, refused):
    options = ("--method", method, "--set", f"{setting}={number}")
    assert "should be at most" in refused(*RENDER, *SMALL, *options)
    assert "should be at most" in refused(*RENDER, *SMALL, "--iterations", number, "0")


@pytest.mark.parametrize("number", [2**63, 10**30, 10**5000], ids=["2^63", "1e30", "1e5000"])
def test_messages_are_as_short_for_long_numbers(number):
    with pytest.raises(ValueError, match=r"^n should be at most 9223372036854775807, but is ") as e:
        validation.count(number, "n")
    assert len(str(e.value)) < 80
    with pytest.raises(ValueError, match="but is "):
        validation.count(-number, "n")
    with pytest.raises(ValueError, match=r"seed should be below 2\^64"):
        validation.check_seed(number + 2**64)


def test_floats_are_no_counts():
    for value in (1e30, np.inf, 3.0, "3"):
        with pytest.raises(TypeError, match="should be an integer"):
            validation.count(value, "n")


# --- memory ---------------------------------------------------------------------------------------


@pytest.fixture
def available(monkeypatch):
    """Sets how much memory there is."""

    def available(n_bytes):
        monkeypatch.setattr(memory, "_SMALL", 0)
        for module in (memory, trace, view):
            monkeypatch.setattr(module, "available_memory", lambda: n_bytes)

    return available


@pytest.mark.parametrize("paths", ["caustic", "all"])
def test_photons_that_surely_do_not_fit_are_refused(paths, ring, available):
    n = 200_000
    traced = pr.trace_photons(ring, n, paths=paths, max_bounces=4)
    size = 148.0 * len(traced)
    available(size)
    same = pr.trace_photons(ring, n, paths=paths, max_bounces=4)
    np.testing.assert_array_equal(same.position, traced.position)
    available(0.4 * size)
    with pytest.raises(MemoryError, match=r"stored of 200,000 emitted take at least .* emit fewer"):
        pr.trace_photons(ring, n, paths=paths, max_bounces=4)


@pytest.mark.parametrize("n_emitted", [10**12, 10**15])
def test_numbers_of_photons_beyond_any_memory_are_refused_at_once(n_emitted, ring):
    with pytest.raises(MemoryError, match="emit fewer"):
        pr.trace_photons(ring, n_emitted)
    with pytest.raises(MemoryError, match="emit fewer"):
        pr.render_progressive(ring, n_passes=1, photons_per_pass=n_emitted)
    with pytest.raises(MemoryError, match="emit fewer"):
        ComparisonRequest(subject=gallery_subject("ring", 16, 16), n_emitted=n_emitted)
    with pytest.raises(MemoryError, match="emit fewer"):
        gallery.pattern("shapes", n=n_emitted)


def test_photons_of_a_reference_are_checked_before_the_comparison(tmp_path):
    request = ComparisonRequest(subject=gallery_subject("ring", 16, 16), n_emitted=1000)
    settings = ReferenceSettings(photons=10**14)
    with pytest.raises(MemoryError, match="emit fewer"):
        check_computable(tmp_path / "reference.exr", request, settings)


@pytest.mark.parametrize(
    "camera", [{"width": 10**6, "height": 10**6}, {"width": 2**31 - 1}, {"height": 2**31 - 1}]
)
def test_images_beyond_memory_are_refused(camera, ring):
    large = replace(ring, camera=replace(ring.camera, **camera))
    with pytest.raises(MemoryError, match="make the image smaller"):
        pr.render(large, n_emitted=100)
    with pytest.raises(MemoryError, match="make the image smaller"):
        pr.render_progressive(large, n_passes=1)


def test_hit_points_that_surely_do_not_fit_are_refused(ring, available):
    seen = view.View(ring)
    bands = seen.stored(None).bands
    size = 128.0 * sum(len(band.hits) for band in bands)
    available(size)
    assert len(seen.stored(None).bands) == len(bands)
    available(0.4 * size)
    with pytest.raises(MemoryError, match="take fewer samples"):
        seen.stored(None)


def test_samples_beyond_memory_are_refused(ring):
    with pytest.raises(MemoryError, match="take fewer"):
        pr.render(ring, n_emitted=100, supersampling=10**6)
    with pytest.raises(MemoryError, match="take fewer samples"):
        ComparisonRequest(subject=gallery_subject("shapes"), supersampling=10**4)


def test_results_beyond_memory_are_refused():
    tree = KDTree(np.random.default_rng(0).random((100, 3)))
    with pytest.raises(MemoryError, match="neighbours of each of 100 queries"):
        tree.query(np.zeros((100, 3)), 2**40)
    with pytest.raises(MemoryError, match="neighbours of each of 100 queries"):
        tree.query_self(2**40)
    with pytest.raises(MemoryError, match="Halton points"):
        halton(0, 2**50)
