"""SJ13's Table I as one benchmark; ``python -m bench table1`` prints it with the paper's."""

import pytest

from bench.arguments import numbers
from bench.speed import inputs
from bench.studies import table1


@pytest.fixture(scope="session")
def n_emitted(request):
    """As in the paper, or as many as the greatest of the photon counts asked for takes."""
    if request.config.getoption("benchmark_disable"):
        return 50_000
    counts = request.config.getoption("photons")
    if counts is None:
        return 20_000_000
    return int(max(numbers(counts)) / inputs.STORED)


def test_table1(benchmark, n_emitted, pixels):
    rows = benchmark.pedantic(table1.measured, args=(n_emitted,), kwargs={"pixels": pixels})
    assert rows.keys() == table1.PAPER.keys()
    stages = [rows[row] for row in table1.PAPER if not row.startswith(("photons", "total"))]
    assert abs(sum(stages) - rows["total"]) < 1e-6
    benchmark.extra_info["photons_per_second"] = rows["photons stored"] / rows["total"]
    benchmark.extra_info |= {
        row: {"photonrelax": rows[row], "SJ13": value} for row, value in table1.PAPER.items()
    }
