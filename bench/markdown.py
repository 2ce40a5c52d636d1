"""Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def markdown_table(column_titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Markdown table of texts.

    Parameters
    ----------
    column_titles : sequence of str
        One a column; may be empty texts.
    rows : iterable of sequences of str
        Cells of each row, as many as there are columns.

    Returns
    -------
    str
        Lines of the table, without a line break after the last.

    Raises
    ------
    ValueError
        If a row has another number of cells than there are columns.
    """
    lines = [_line(column_titles), _line(["---"] * len(column_titles))]
    for cells in rows:
        if len(cells) != len(column_titles):
            raise ValueError(
                f"rows should have {len(column_titles)} cells, but one has {len(cells)}: {cells}"
            )
        lines.append(_line(cells))
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return "|" + "".join(f" {cell} |" if cell else " |" for cell in cells)
