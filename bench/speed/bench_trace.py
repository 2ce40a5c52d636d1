"""Emission and tracing, and how much of tracing is embree's."""

from bench.speed import inputs, stages


def test_emission(timed, n, n_threads):
    plan = stages.planned(n)
    timed(lambda: stages.emission(plan, n_threads), n, f"emission {n} {n_threads=}")


def test_trace(timed, n, n_threads):
    photons = timed(lambda: stages.trace(n, n_threads), n, f"trace {n} {n_threads=}")
    assert photons.n_emitted == n


def test_shading_beside_embree(benchmark, n):
    """On one thread; the time is that of both and of emission."""
    inputs.scene()
    parts = benchmark.pedantic(stages.traced_apart, args=(n,))
    benchmark.extra_info |= {name: part.wall[0] for name, part in parts.items()}
    benchmark.extra_info["photons_per_second"] = n / sum(p.wall[0] for p in parts.values())
    benchmark.extra_info["shading_over_embree"] = parts["shading"].wall[0] / parts["embree"].wall[0]
    assert parts["embree"].wall[0] > 0.0
