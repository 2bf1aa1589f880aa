"""A loop that does nothing, on the recorder's own ticker: what beat this machine can keep."""

from __future__ import annotations

import multiprocessing
import time
from multiprocessing.connection import Connection

import numpy as np

from uniforce_robots.recorder.ticker import Ticker

END_s = 60.0


def tick(rate_hz: float, pipe: Connection) -> None:
    """Tick until something comes through the pipe or it ends; send when each beat came, s, and how late it was, ms."""
    ticker, time_s, late_ms = Ticker(rate_hz), [], []
    while not pipe.poll():
        late_ms.append(round(1e3 * ticker.wait(), 4))
        time_s.append(round(time.monotonic(), 4))
    pipe.send((time_s, late_ms))


class IdleLoop:
    """Runs beside a session, in a process of its own.

    Args:
        rate_hz: of the beat.
    """

    def __init__(self, rate_hz: float) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._pipe, theirs = spawn.Pipe()
        self._process = spawn.Process(target=tick, args=(rate_hz, theirs), daemon=True)
        self._process.start()
        theirs.close()

    @property
    def pid(self) -> int:
        """Of the process."""
        return int(self._process.pid or 0)

    def __enter__(self) -> IdleLoop:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.join()

    def stop(self) -> tuple[np.ndarray, np.ndarray]:
        """End it; return (when each beat came, ``time.monotonic`` s, how late it was, ms).

        Raises:
            TimeoutError: it doesn't answer.
        """
        self._pipe.send("end")
        if not self._pipe.poll(END_s):
            raise TimeoutError(f"the idle loop did not end within {END_s:g} s")
        time_s, late_ms = self._pipe.recv()
        return np.array(time_s), np.array(late_ms)
