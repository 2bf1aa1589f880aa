"""The wiping sequence every scripted controller shares: where to go next, and when.

A *regulator* decides how hard to grip and to press: with touch (the expert's), or without.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from lerobot_env_uniforce_wiping.levels import CONTROL_HZ, Level

if TYPE_CHECKING:
    from lerobot_env_uniforce_wiping.env import WipeEnv

X, Y, Z, YAW, WIDTH = range(5)
STRAY_SHARE = 0.05  # of the inked cells: so few don't make a row the first inked one
LOOKS_BACK = 2  # times a board that is not clean is wiped again: more don't fit into an episode
NEAR_m = 0.002  # arrived
SLOW_DOWN_m = 0.008  # before a corner
APPROACH_GAIN = 7.0  # 1/s: speed per distance left, so that moves end softly
# A soft arm lags behind its command by .3 s, a stiff one by .1 s. A policy observes neither the
# command nor the stiffness. Braking early makes the speed show how far there is left to go
# (docs/experiments/tiny_policy.md).
HEIGHT_GAIN = 2.5  # 1/s
# a hand beside the row's beginning comes to it on the way down and, what is left, along the stroke
STRAY_GAIN = 2.5  # 1/s


@dataclass(frozen=True)
class Pace:
    """Speeds of a run; a person's vary a little from one run to the next."""

    horizontal_m_s: float = 0.115
    vertical_m_s: float = 0.055
    stroke_m_s: float = 0.080
    shift_m_s: float = 0.045  # between rows: drag along the closing axis loads one pad more
    ramp_m_s2: float = 0.5  # change of speed along the sweep


class Regulator(Protocol):
    """Decides grip and press, each from the current target and the measured state."""

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Return the next width target and whether the grasp is made."""

    def hold(self, target_m: float, measured: np.ndarray) -> float:
        """Return the next width target while carrying and wiping."""

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Return the next z target and whether the eraser presses hard enough to start."""

    def press(self, target_m: float, measured: np.ndarray) -> float:
        """Return the next z target while wiping."""

    def lost(self) -> bool:
        """Return whether the eraser has left the board; always False without touch."""


class Sweep:
    """A polyline over the nominal board, by arc length.

    A memoryless policy can follow it: the row's x decides the direction, the end of a row leads to
    the next row's x, and the last end is left upwards.
    """

    def __init__(self, level: Level) -> None:
        cx, cy = level.layout.board_center_m
        rows = cx + (np.arange(level.rows) - (level.rows - 1) / 2) * level.row_pitch_m
        ends = (cy - level.stroke_m / 2, cy + level.stroke_m / 2)
        corners = []
        for k, x in enumerate(rows):
            start, stop = ends if k % 2 == 0 else ends[::-1]
            corners += [(x, start), (x, stop)]
        self.corners = np.array(corners)
        self._at = np.concatenate(
            [[0.0], np.cumsum(np.linalg.norm(np.diff(self.corners, axis=0), axis=1))]
        )

    @property
    def length_m(self) -> float:
        """Total arc length."""
        return float(self._at[-1])

    def row_at(self, x_m: float) -> float:
        """Return the arc length at which the row nearest to an x begins."""
        rows = self.corners[::2, 0]
        return float(self._at[2 * int(np.argmin(np.abs(rows - x_m)))])

    def between_rows(self, along_m: float) -> bool:
        """Return whether the tool moves from row to row there, along the closing axis."""
        return (
            bool(np.searchsorted(self._at, along_m, side="right") % 2 == 0)
            and along_m < self.length_m
        )

    def point(self, along_m: float) -> np.ndarray:
        """Return (2,) x, y at an arc length, clamped to the ends."""
        x = np.interp(along_m, self._at, self.corners[:, 0])
        y = np.interp(along_m, self._at, self.corners[:, 1])
        return np.array([x, y])


def look_back(env: WipeEnv) -> float | None:
    """Return the x at which the ink that is left begins, m, or None when the board counts as wiped.

    Cameras show the same to a policy; scripts spare themselves the vision.
    """
    ink = env.sim.ink
    if ink.residual <= env.limits.residual_share:
        return None
    on_board_x_m = float(np.quantile(ink.dirty_x_m, STRAY_SHARE))
    return float(env.level.layout.board_center_m[0] + env.scene.board_shift_m[0] + on_board_x_m)


class WipeSequence:
    """Targets as a smooth function of the phase, the measured state and the regulator.

    Args:
        level: for the layout.
        regulator: chooses grip and press.
        target: (5,) the tool's own pose, to start from.
        look: returns the x at which the ink that is left begins, m, None where the board is clean.
        pace: speeds.
        stray: draws by how much, (2,) m, the hand misses the beginning of a row; None: not at all.
    """

    def __init__(
        self,
        level: Level,
        regulator: Regulator,
        target: np.ndarray,
        look: Callable[[], float | None],
        pace: Pace | None = None,
        stray: Callable[[], np.ndarray] | None = None,
    ) -> None:
        self.level = level
        self.regulator = regulator
        self.pace = pace or Pace()
        self.sweep = Sweep(level)
        self.target = np.array(target, dtype=np.float64)
        self.phase = "descend"
        # each moves the target and returns the phase to go on with
        self._phases: dict[str, Callable[[np.ndarray], str]] = {
            "descend": self._descend,
            "close": self._close,
            "lift": self._lift,
            "carry": self._carry,
            "lower": self._lower,
            "wipe": self._wipe,
            "leave": self._leave,
            "done": self._stay,
        }
        self._look = look
        self._looks_left = LOOKS_BACK
        self._along_m = 0.0
        self._speed_m_s = 0.0
        self._draw_stray = stray or (lambda: np.zeros(2))
        self._stray_m = self._draw_stray()

    def next(self, measured: np.ndarray) -> np.ndarray:
        """Return the next absolute target (5,)."""
        self.phase = self._phases[self.phase](measured)
        return self.target.copy()

    def _move(self, goal: dict[int, float]) -> bool:
        """Slew the target towards the goal; True once every coordinate is near."""
        speed = {axis: APPROACH_GAIN * (value - self.target[axis]) for axis, value in goal.items()}
        sideways = np.hypot(speed.get(X, 0.0), speed.get(Y, 0.0))
        slower = min(1.0, self.pace.horizontal_m_s / max(sideways, 1e-9))  # along the straight line
        for axis, wanted in speed.items():
            if axis in (X, Y):
                step = wanted * slower
            else:
                limit = self.pace.vertical_m_s if axis == Z else self.pace.horizontal_m_s
                step = np.clip(wanted, -limit, limit)
            self.target[axis] += step / CONTROL_HZ
        return all(abs(self.target[axis] - value) < NEAR_m for axis, value in goal.items())

    def _go_to_height(self, goal_m: float, measured: np.ndarray) -> None:
        """Slew the z target until target and *measured* height are a goal on average.

        A hand that is pushed away comes back half the way. The measured height alone lags too much.
        """
        missing_m = goal_m - (self.target[Z] + measured[Z]) / 2
        limit = self.pace.vertical_m_s
        self.target[Z] += float(np.clip(HEIGHT_GAIN * missing_m, -limit, limit)) / CONTROL_HZ

    def _follow_sweep(self, step_m: float = 0.0) -> None:
        """Move the target along the sweep, and a little closer to it."""
        stray_m = self.target[[X, Y]] - self.sweep.point(self._along_m)
        self._along_m += step_m
        self.target[[X, Y]] = (
            self.sweep.point(self._along_m) + (1 - STRAY_GAIN / CONTROL_HZ) * stray_m
        )

    def _descend(self, measured: np.ndarray) -> str:
        layout = self.level.layout
        here = self._move({X: layout.tray_m[0], Y: layout.tray_m[1], WIDTH: layout.open_width_m})
        self._go_to_height(layout.grasp_height_m, measured)
        is_down = measured[Z] < layout.grasp_height_m + 2 * NEAR_m
        return "close" if here and is_down else "descend"

    def _close(self, measured: np.ndarray) -> str:
        self._go_to_height(self.level.layout.grasp_height_m, measured)
        self.target[WIDTH], is_held = self.regulator.close(self.target[WIDTH], measured)
        return "lift" if is_held else "close"

    def _lift(self, measured: np.ndarray) -> str:
        self.target[WIDTH] = self.regulator.hold(self.target[WIDTH], measured)
        self._go_to_height(self.level.layout.carry_height_m, measured)
        is_up = measured[Z] > self.level.layout.carry_height_m - 0.010
        return "carry" if is_up else "lift"

    def _carry(self, measured: np.ndarray) -> str:
        self.target[WIDTH] = self.regulator.hold(self.target[WIDTH], measured)
        self._go_to_height(self.level.layout.carry_height_m, measured)
        # of the first row, or of the first that is still dirty
        start = self.sweep.point(self._along_m) + self._stray_m
        self._move({X: start[0], Y: start[1]})
        is_there = np.linalg.norm(measured[:2] - start) < 2 * NEAR_m
        return "lower" if is_there else "carry"

    def _lower(self, measured: np.ndarray) -> str:
        self.target[WIDTH] = self.regulator.hold(self.target[WIDTH], measured)
        self._follow_sweep()  # to the start, or where the board was lost
        self.target[Z], pressed = self.regulator.lower(self.target[Z], measured)
        return "wipe" if pressed else "lower"

    def _wipe(self, measured: np.ndarray) -> str:
        if self.regulator.lost():  # over a clean board it is done, over ink it goes down again
            self._speed_m_s = 0.0
            return "leave" if self._look() is None else "lower"
        shifting = self.sweep.between_rows(self._along_m + SLOW_DOWN_m)
        # drag along the closing axis loads the pads unevenly: hold still and trust the gel
        if not shifting:
            self.target[WIDTH] = self.regulator.hold(self.target[WIDTH], measured)
            self.target[Z] = self.regulator.press(self.target[Z], measured)
        wanted = self.pace.shift_m_s if shifting else self.pace.stroke_m_s
        limit = self.pace.ramp_m_s2 / CONTROL_HZ
        self._speed_m_s += float(np.clip(wanted - self._speed_m_s, -limit, limit))
        self._follow_sweep(self._speed_m_s / CONTROL_HZ)
        if self._along_m < self.sweep.length_m:
            return "wipe"
        return self._look_back()

    def _look_back(self) -> str:
        """Return "leave" over a clean board, else "lift": the eraser is carried to the ink."""
        dirty_x_m = self._look() if self._looks_left else None
        if dirty_x_m is None:
            return "leave"
        self._along_m = self.sweep.row_at(dirty_x_m)
        self._speed_m_s = 0.0
        self._looks_left -= 1
        self._stray_m = self._draw_stray()
        return "lift"

    def _leave(self, measured: np.ndarray) -> str:
        self._go_to_height(self.level.layout.carry_height_m + 0.015, measured)
        is_up = measured[Z] > self.level.layout.carry_height_m + 0.005
        return "done" if is_up else "leave"

    def _stay(self, measured: np.ndarray) -> str:
        return "done"
