"""Progress bars of the command line, which also raise an interrupt that was swallowed."""

from __future__ import annotations

import sys
import time
from typing import Any

from .interrupts import Interrupts


class ProgressBars:
    """Progress bars on a terminal, one stage after another; called as a `Progress`."""

    def __init__(self, quiet: bool, interrupts: Interrupts) -> None:
        # None: tqdm disables bars in files and pipes.
        self._disable = True if quiet or sys.stderr is None else None
        self._interrupts = interrupts
        self._stage = ""
        self._bar: Any = None
        self._last_report = time.time()

    def __enter__(self) -> ProgressBars:
        return self

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        self._close()
        if kind is None:
            self._interrupts.check()

    def __call__(self, stage: str, done: int, total: int) -> None:
        from tqdm import tqdm

        self._interrupts.check()
        if stage != self._stage:
            self._close()
            # A thread that is of no use here; where none can be started tqdm prints a warning.
            tqdm.monitor_interval = 0
            self._stage = stage
            self._bar = tqdm(total=total, desc=stage, unit_scale=True, disable=self._disable)
            # The first report of a stage comes late: it started when the last one ended.
            self._bar.start_t = self._last_report
        self._bar.total = total
        self._bar.update(done - self._bar.n)
        self._last_report = time.time()
        if done >= total:
            # The time of the stage is final; tqdm ignores later updates.
            self._close()

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.close()
