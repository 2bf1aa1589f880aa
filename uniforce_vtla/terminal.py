"""A program's end from outside, and its terminal, which may be gone before the program is."""

import io
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TextIO

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # Ctrl-C, kill, a terminal that was closed


class LastingText(io.TextIOBase):
    """Writes to a terminal or pipe; once that is gone, text is lost and nothing is raised."""

    def __init__(self, out: TextIO) -> None:
        self._out = out

    def isatty(self) -> bool:
        """Return whether it is a terminal."""
        return self._out.isatty()

    def write(self, text: str) -> int:
        """Write at once."""
        try:
            self._out.write(text)
            self._out.flush()
        except OSError:
            null = os.open(os.devnull, os.O_WRONLY)
            # for what is still buffered, and for everybody else's words
            os.dup2(null, self._out.fileno())
            os.close(null)
        return len(text)


@contextmanager
def stops_like_ctrl_c() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt while the block lasts.

    Who started the program with a signal ignored, as nohup does, wants it to go on.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    plain = [number for number in STOPS[1:] if signal.getsignal(number) is signal.SIG_DFL]
    for number in plain:
        signal.signal(number, _interrupt)
    try:
        yield
    finally:
        for number in plain:
            signal.signal(number, signal.SIG_DFL)


def _interrupt(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # kernel, shell and login manager each send it
    raise KeyboardInterrupt
