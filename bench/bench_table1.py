"""SJ13's Table I as one benchmark; ``python -m bench table1`` prints it beside the paper's."""

from . import table1


def test_table1(benchmark, pixels):
    n_emitted = 20_000_000 if benchmark.enabled else 50_000
    rows = benchmark.pedantic(table1.measured, args=(n_emitted,), kwargs={"pixels": pixels})
    assert rows.keys() == table1.PAPER.keys()
    stages = [rows[row] for row in table1.PAPER if not row.startswith(("photons", "total"))]
    assert abs(sum(stages) - rows["total"]) < 1e-6
    benchmark.extra_info |= {
        row: {"photonrelax": rows[row], "SJ13": value} for row, value in table1.PAPER.items()
    }
