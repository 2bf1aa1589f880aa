"""Ctrl-C: the first ends the session in order, the second at once."""

from __future__ import annotations

import logging
import signal
from types import FrameType, TracebackType
from typing import Any

log = logging.getLogger(__name__)
SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """Counts interrupts while its ``with`` block lasts; works in the main thread only, as signals do.

    Attributes:
        count: how many came. From the second on, each raises KeyboardInterrupt where the program stands.
    """

    def __init__(self) -> None:
        self.count = 0
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupts:
        self._before = {number: signal.signal(number, self._take) for number in SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
        log.warning("interrupted (%s), %d time(s)", signal.Signals(number).name, self.count)
        if self.count > 1:
            raise KeyboardInterrupt
