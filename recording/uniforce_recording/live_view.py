"""What the operator sees while it records: force against its limits, the age of the oldest sensor, what to press."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TextIO

import numpy as np

from uniforce_recording.observation import Observation

LINE_EVERY_s = 0.2  # a person reads no faster
BAR = 20  # characters


@dataclass(frozen=True)
class ForceLimits:
    """Where a demonstration stops being a good one; scores have the same limits."""

    warn_N: float = 10.0  # mean press above it counts as excess force
    stop_N: float = 15.0  # any frame above it does


class LiveView:
    """Writes one line again and again on a terminal, and lines that stay in between.

    Args:
        out: where to; None shows nothing.
        limits: of the force.
        fps: to tell seconds.
    """

    def __init__(self, out: TextIO | None, limits: ForceLimits | None = None, fps: int = 30) -> None:
        self._out, self._limits, self._fps = out, limits or ForceLimits(), fps
        self._moves = out is not None and out.isatty()  # a line can be written over
        self._next_s = 0.0
        self._peak_N = 0.0

    @property
    def peak_N(self) -> float:  # noqa: N802  a unit
        """Largest force of the episode so far."""
        return self._peak_N

    def begin(self, text: str) -> None:
        """Begin an episode: its peak force is forgotten."""
        self._peak_N = 0.0
        self.say(text)

    def say(self, text: str) -> None:
        """Write a line that stays."""
        self._write(f"\r\x1b[K{text}\n" if self._moves else f"{text}\n")

    def show(self, seen: Observation, frames: int) -> None:
        """Show an observation, five times a second on a terminal, never elsewhere."""
        self._peak_N = max(self._peak_N, float(np.linalg.norm(seen.force_N)))
        now_s = time.perf_counter()
        if self._moves and now_s >= self._next_s:
            self._next_s = now_s + LINE_EVERY_s
            self._write("\r\x1b[K" + self.line(seen, frames))

    def line(self, seen: Observation, frames: int) -> str:
        """Return the line: time, force as a bar up to its limit, peak, width, oldest sensor."""
        force_N, limits = float(np.linalg.norm(seen.force_N)), self._limits
        filled = min(round(BAR * force_N / limits.stop_N), BAR)
        mark = "!!" if force_N > limits.stop_N else "! " if force_N > limits.warn_N else "  "
        oldest, age_ms = _oldest(seen)
        return (
            f"{frames / self._fps:5.1f} s  force [{'#' * filled}{'.' * (BAR - filled)}] {force_N:4.1f} N {mark}"
            f"peak {self._peak_N:4.1f} of {limits.stop_N:g}  width {1000 * seen.axes[4]:4.1f} mm"
            f"  oldest {oldest} {age_ms:.0f} ms"
        )

    def _write(self, text: str) -> None:
        if self._out is not None:
            self._out.write(text)
            self._out.flush()


def _oldest(seen: Observation) -> tuple[str, float]:
    times = {name: picture.time_s for name, picture in seen.cameras.items()}
    times |= {f"{finger} finger": touch.time_s for finger, touch in seen.fingers.items()}
    name = min(times, key=lambda source: times[source])
    return name, 1000 * (seen.time_s - times[name])
