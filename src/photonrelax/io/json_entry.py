"""Members of JSON objects, checked one by one; errors say where they are."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any, TypeGuard

import numpy as np

from .._util.validation import Floats

_SHOWN = 60


def parse(text: bytes, name: str) -> JsonEntry:
    """The object that JSON text holds.

    Raises
    ------
    ValueError
        If it is no JSON, or no object.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{name} should hold JSON, but does not: {error}") from None
    return JsonEntry(value, name)


class JsonEntry:
    """A JSON object, and where it is in its file.

    All methods raise ValueError if a member is not of the kind that they return.
    """

    def __init__(self, value: Any, where: str) -> None:
        if not isinstance(value, dict):
            raise ValueError(f"{where} should be a JSON object, but is {_shown(value)}")
        self._members: dict[str, Any] = value
        self.where = where

    def __contains__(self, key: str) -> bool:
        return key in self._members

    def names(self) -> tuple[str, ...]:
        """Names of the members."""
        return tuple(self._members)

    def value(self, key: str) -> Any:
        """A member as it is, None if there is none."""
        return self._members.get(key)

    def error(self, key: str, expected: str) -> ValueError:
        """Error about a member that is not as expected."""
        return ValueError(
            f"{self.where}.{key} should be {expected}, but is {_shown(self._members.get(key))}"
        )

    def number(
        self, key: str, default: float, low: float = -math.inf, high: float = math.inf
    ) -> float:
        """A finite number in [low, high]."""
        value = self._members.get(key, default)
        if not (_is_number(value) and low <= value <= high):
            within = "" if math.isinf(low) and math.isinf(high) else f" in [{low:g}, {high:g}]"
            raise self.error(key, f"a number{within}")
        return float(value)

    def numbers(
        self,
        key: str,
        default: Sequence[float],
        low: float = -math.inf,
        high: float = math.inf,
    ) -> Floats:
        """As many finite numbers in [low, high] as the default has."""
        value = self._members.get(key, default)
        fits = isinstance(value, list | tuple) and len(value) == len(default)
        if not (fits and all(_is_number(each) and low <= each <= high for each in value)):
            within = "" if math.isinf(low) and math.isinf(high) else f" in [{low:g}, {high:g}]"
            raise self.error(key, f"{len(default)} numbers{within}")
        return np.array(value, dtype=np.float64)

    def count(self, key: str, default: int | None = None, high: float = 2.0**53) -> int:
        """A whole number in [0, high]; without a default it has to be there."""
        value = self._members.get(key, default)
        if not (_is_number(value) and 0 <= value <= high and value == int(value)):
            raise self.error(key, f"a whole number from 0 to {high:.0f}")
        return int(value)

    def index(self, key: str, n: int) -> int | None:
        """Index of one of n things, None if there is no such member."""
        if key not in self._members:
            return None
        if n == 0:
            raise self.error(key, "absent, as there is nothing that it could be the index of")
        return self.count(key, high=n - 1)

    def text(self, key: str, default: str = "") -> str:
        """Text."""
        value = self._members.get(key, default)
        if not isinstance(value, str):
            raise self.error(key, "text")
        return value

    def flag(self, key: str) -> bool:
        """True or false; false if there is no such member."""
        value = self._members.get(key, False)
        if not isinstance(value, bool):
            raise self.error(key, "true or false")
        return value

    def entry(self, key: str) -> JsonEntry:
        """An object; an empty one if there is no such member."""
        return JsonEntry(self._members.get(key, {}), f"{self.where}.{key}")

    def entries(self, key: str) -> list[JsonEntry]:
        """A list of objects; an empty one if there is no such member."""
        values = self._list(key)
        return [JsonEntry(each, f"{self.where}.{key}[{i}]") for i, each in enumerate(values)]

    def texts(self, key: str) -> list[str]:
        """A list of texts; an empty one if there is no such member."""
        values = self._list(key)
        if not all(isinstance(each, str) for each in values):
            raise self.error(key, "a list of texts")
        return values

    def indices(self, key: str, n: int) -> list[int]:
        """A list of indices of n things; an empty one if there is no such member."""
        values = self._list(key)
        if not all(type(each) is int and 0 <= each < n for each in values):
            raise self.error(key, f"a list of whole numbers below {n}")
        return values

    def _list(self, key: str) -> list[Any]:
        value = self._members.get(key, [])
        if not isinstance(value, list):
            raise self.error(key, "a list")
        return value


def _is_number(value: Any) -> TypeGuard[int | float]:
    """True for a number that is finite as a float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _shown(value: Any) -> str:
    text = repr(value) if not isinstance(value, dict | list) else json.dumps(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"
