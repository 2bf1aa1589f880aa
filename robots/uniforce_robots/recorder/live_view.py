"""What the operator sees while it records: force against its limits, the age of the oldest sensor, what to press."""

import time
from typing import TextIO

import numpy as np

from uniforce_robots.recorder.rig import Observation
from uniforce_vtla.evaluation.episode import ScoreLimits

LINE_EVERY_s = 0.2  # a person reads no faster
BAR = 20  # characters
WARN_N, STOP_N = ScoreLimits.mean_press_N, ScoreLimits.peak_press_N  # above them a score has excess force


class LiveView:
    """Writes one line again and again on a terminal, and lines that stay in between; without ``out`` nothing.

    ``peak_N`` is the largest force of the episode so far.
    """

    def __init__(self, out: TextIO | None, fps: int = 30) -> None:
        self._out, self._fps = out, fps
        self._moves = out is not None and out.isatty()  # a line can be written over
        self._next_s = self.peak_N = 0.0

    def begin(self, text: str) -> None:
        """Begin an episode: its peak force is forgotten."""
        self.peak_N = 0.0
        self.say(text)

    def say(self, text: str) -> None:
        """Write a line that stays."""
        if self._out is not None:
            self._out.write(f"\r\x1b[K{text}\n" if self._moves else f"{text}\n")
            self._out.flush()

    def show(self, seen: Observation, frames: int) -> None:
        """Show an observation, five times a second on a terminal, never elsewhere."""
        self.peak_N = max(self.peak_N, float(np.linalg.norm(seen.force_N)))
        now_s = time.perf_counter()
        if self._out is not None and self._moves and now_s >= self._next_s:
            self._next_s = now_s + LINE_EVERY_s
            self._out.write("\r\x1b[K" + self.line(seen, frames))
            self._out.flush()

    def line(self, seen: Observation, frames: int) -> str:
        """Return the line: time, force as a bar up to its limit, peak, width, oldest sensor."""
        force_N = float(np.linalg.norm(seen.force_N))
        filled = min(round(BAR * force_N / STOP_N), BAR)
        mark = "!!" if force_N > STOP_N else "! " if force_N > WARN_N else "  "
        oldest, sample = min(seen.samples.items(), key=lambda named: named[1].time_s)
        age_ms = 1000 * (seen.time_s - sample.time_s)
        return (
            f"{frames / self._fps:5.1f} s  force [{'#' * filled}{'.' * (BAR - filled)}] {force_N:4.1f} N {mark}"
            f"peak {self.peak_N:4.1f} of {STOP_N:g}  width {1000 * seen.axes[4]:4.1f} mm"
            f"  oldest {oldest} {age_ms:.0f} ms"
        )
