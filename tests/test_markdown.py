"""Markdown tables."""

import pytest
from bench.markdown import markdown_table


def test_a_table_has_titles_a_rule_and_a_line_a_row():
    assert markdown_table(["", "a", "b"], [["x", "1", "2"], ["y", "3", "4"]]).splitlines() == [
        "| | a | b |",
        "| --- | --- | --- |",
        "| x | 1 | 2 |",
        "| y | 3 | 4 |",
    ]
    assert markdown_table(["a"], []) == "| a |\n| --- |"


def test_rows_of_another_length_are_refused():
    with pytest.raises(ValueError, match="should have 2 cells, but one has 1"):
        markdown_table(["a", "b"], [["x"]])
