"""Ctrl-C that is not forgotten when a library swallows it."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType


class Interrupts:
    """While entered, records SIGINT besides raising KeyboardInterrupt.

    Libraries with a bare ``except`` around imports swallow the exception; `check` raises it again.

    Attributes
    ----------
    pending : bool
        Whether a SIGINT came.
    """

    def __init__(self) -> None:
        self.pending = False
        self._installed = False

    def __enter__(self) -> Interrupts:
        # Other threads may not set handlers; a caller's own handler, or none at all, is kept.
        self._installed = (
            threading.current_thread() is threading.main_thread()
            and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        )
        if self._installed:
            signal.signal(signal.SIGINT, self._record)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._installed:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def check(self) -> None:
        """Raise KeyboardInterrupt if a SIGINT came, also if somebody swallowed it."""
        if self.pending:
            raise KeyboardInterrupt

    def _record(self, number: int, frame: FrameType | None) -> None:
        self.pending = True
        raise KeyboardInterrupt
