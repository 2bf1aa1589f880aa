"""A recorded uSkin trial, played at its rate: a finger for people without a patch, and for looking at a log again."""

from __future__ import annotations

import time

import numpy as np

from uniforce_robots.sensors.faults import LostSensorError
from uniforce_robots.sensors.samples import NS_PER_S, SourceCounts, Stamped, now_ns
from uniforce_vtla.errors import ContractError, SensorError, expected
from uniforce_vtla.sensors.uskin_csv import read_uskin_csv

WAIT_S = 0.05  # one read waits at most this long
MAX_BEHIND_S = 0.5  # after a longer gap the time table starts anew instead of bursting
FULL_SCALE = 65_535


class ReplayUSkin:
    """Scans, (16, 3) uint16 raw counts each, of a csv of ``sensors.uskin_csv``.

    Args:
        path: the csv.
        rate_hz: scans per second; the csv doesn't say.
        loop: begin anew at the end; otherwise its end is a lost sensor.
        name: how errors call it.

    Raises:
        ContractError: a rate that isn't above 0.
    """

    def __init__(self, path: str, rate_hz: float, loop: bool = False, name: str = "uskin") -> None:
        if not rate_hz > 0:
            raise ContractError(expected("replay rate", "above 0 Hz", rate_hz, "Give the log's rate."))
        self.name = f"{name} (replay of {path})"
        self._path, self._period_ns, self._loop = path, round(NS_PER_S / rate_hz), loop
        self._scans: np.ndarray | None = None
        self._step = self._played = 0
        self._next_ns = 0

    @property
    def counts(self) -> SourceCounts:
        """Scans played."""
        return SourceCounts(samples=self._played)

    def open(self) -> None:
        """Read the file and begin with its first scan.

        Raises:
            SensorError: no such log, counts beyond 16 bits, or it was played to its end before.
        """
        scans = read_uskin_csv(self._path)
        if scans.min() < 0 or scans.max() > FULL_SCALE:
            came = f"{scans.min()} … {scans.max()}"
            do = "Log raw counts, before any baseline."
            raise SensorError(expected(self.name, f"counts in 0 … {FULL_SCALE}", came, do))
        self._refuse_the_end(scans)  # a reader that reopens must not begin anew unnoticed
        self._scans, self._step, self._next_ns = scans.astype(np.uint16), 0, now_ns()

    def read(self) -> list[Stamped]:
        """Return the scan that is due, or nothing; raises LostSensorError at the end of the recording."""
        if self._scans is None:
            raise LostSensorError(expected(self.name, "an open recording", "none", "Call open()."))
        self._refuse_the_end(self._scans)
        wait_s = (self._next_ns - now_ns()) / NS_PER_S
        time.sleep(min(max(wait_s, 0.0), WAIT_S))
        if wait_s > WAIT_S:
            return []
        scan = self._scans[self._step % len(self._scans)]
        self._step, self._played = self._step + 1, self._played + 1
        late_ns = now_ns() - self._next_ns
        self._next_ns += self._period_ns if late_ns < MAX_BEHIND_S * NS_PER_S else late_ns
        return [Stamped(now_ns(), scan)]

    def close(self) -> None:
        """Put the recording away."""
        self._scans = None

    def _refuse_the_end(self, scans: np.ndarray) -> None:
        if self._step >= len(scans) and not self._loop:
            do = "Set replay_loop=true to begin anew."
            raise LostSensorError(expected(self.name, "another scan", "the end of the recording", do))
