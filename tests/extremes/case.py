"""Rows of the table of extremes."""

from collections.abc import Callable
from typing import NamedTuple


class Case(NamedTuple):
    """An extreme, what it is measured against, a bound, and the function that gives its error."""

    name: str
    against: str
    bound: float
    error: Callable[..., float]
