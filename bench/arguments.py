"""Arguments that benchmarks share."""

from __future__ import annotations


def numbers(text: str) -> list[int]:
    """Return the whole numbers of a text such as "1e5,863e3"."""
    return [int(float(number)) for number in text.split(",")]
