"""Progress reports of long loops, in chunks between which Ctrl-C is served."""

from __future__ import annotations

from collections.abc import Callable, Iterator

# Called as ``progress(stage, done, total)``, from the thread that called the stage.
Progress = Callable[[str, int, int], None]

# Rows a kernel is given at a time.
CHUNK = 65536


class Reporter:
    """Counts finished work of one stage and reports it."""

    def __init__(self, progress: Progress | None, stage: str, total: int) -> None:
        self._progress = progress
        self._stage = stage
        self._total = total
        self._done = 0

    def advance(self, amount: int) -> None:
        """Count `amount` as done."""
        self._done += amount
        if self._progress is not None:
            self._progress(self._stage, self._done, self._total)

    def chunks(self, n: int, size: int = CHUNK) -> Iterator[tuple[int, int]]:
        """Yield (first, end) of consecutive chunks of n rows, and count each when it is done."""
        for first in range(0, n, size):
            end = min(first + size, n)
            yield first, end
            self.advance(end - first)


def prefixed(progress: Progress | None, prefix: str) -> Progress | None:
    """Return a callback that reports stages as ``prefix: stage``."""
    if progress is None:
        return None
    return lambda stage, done, total: progress(f"{prefix}: {stage}", done, total)
