"""Signals that end a run: Ctrl-C, a request to terminate, and the end of the terminal."""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any

# Signals, and the handlers that are replaced; one of the caller, or none (``nohup``), stays.
_DEFAULTS: dict[int, Any] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
    signal.SIGHUP: signal.SIG_DFL,
}
_ENDS: dict[int, str] = {
    signal.SIGINT: "interrupted",
    signal.SIGTERM: "terminated",
    signal.SIGHUP: "hung up",
}


class Interrupts:
    """Context in which SIGINT, SIGTERM and SIGHUP raise KeyboardInterrupt, and are recorded.

    Libraries with a bare ``except`` around imports swallow the exception; `check` raises it again,
    and so does the next import.

    Attributes
    ----------
    received : int
        The first signal that was received, 0 before.
    """

    def __init__(self) -> None:
        self.received = 0
        self._installed: list[int] = []

    def __enter__(self) -> Interrupts:
        # Only the main thread may set handlers.
        if threading.current_thread() is threading.main_thread():
            for number, default in _DEFAULTS.items():
                if signal.getsignal(number) == default:
                    signal.signal(number, self._record)
                    self._installed.append(number)
        sys.meta_path.insert(0, self)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        sys.meta_path.remove(self)
        for number in self._installed:
            signal.signal(number, _DEFAULTS[number])

    @property
    def exit_code(self) -> int:
        """128 and the number of the signal, as shells have it."""
        return 128 + (self.received or signal.SIGINT)

    @property
    def reason(self) -> str:
        """End of the run in words."""
        return _ENDS[self.received or signal.SIGINT]

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal was received, even if it was swallowed."""
        if self.received:
            raise KeyboardInterrupt

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        """Find no module: importing calls this, and hears of a signal that was swallowed."""
        # What is imported while an exception is handled may be needed to save the run.
        if sys.exc_info()[0] is None:
            self.check()

    def _record(self, number: int, frame: FrameType | None) -> None:
        is_first = not self.received
        self.received = self.received or number
        # The end of a session sends several: only another Ctrl-C breaks off saving the run.
        if is_first or number == signal.SIGINT:
            raise KeyboardInterrupt
