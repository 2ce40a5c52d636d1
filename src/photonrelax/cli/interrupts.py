"""Interrupts that libraries swallow."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType


class Interrupts:
    """Context that records SIGINT beside raising KeyboardInterrupt.

    Libraries with a bare ``except`` around imports swallow the exception; `check` raises it again.

    Attributes
    ----------
    pending : bool
        A SIGINT was received.
    """

    def __init__(self) -> None:
        self.pending = False
        self._installed = False

    def __enter__(self) -> Interrupts:
        # Only the main thread may set handlers; a handler of the caller stays.
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
        """Raise KeyboardInterrupt if a SIGINT was received, even if it was swallowed."""
        if self.pending:
            raise KeyboardInterrupt

    def _record(self, number: int, frame: FrameType | None) -> None:
        self.pending = True
        raise KeyboardInterrupt
