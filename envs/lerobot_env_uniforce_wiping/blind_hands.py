"""Hands that feel nothing: grip and press from a nominal position, or from a fixed distance inside the measured one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lerobot_env_uniforce_wiping.hands import CLEARANCE_m, CLOSING_m_s, SLOW_m_s, lowering_speed
from lerobot_env_uniforce_wiping.levels import Layout
from lerobot_env_uniforce_wiping.mjcf import GRIPPER_N_m, STIFFNESS_N_m
from lerobot_env_uniforce_wiping.simulation import CONTROL_HZ

SETTLE_steps = 12  # waited at a position before the next phase


@dataclass(frozen=True)
class BlindSettings:
    """A blind script's set points, turned into positions by nominal stiffnesses."""

    press_N: float
    grip_N: float

    @property
    def press_depth_m(self) -> float:
        """How far below the contact the z target goes."""
        return self.press_N / STIFFNESS_N_m[2]

    @property
    def grip_depth_m(self) -> float:
        """How far inside the eraser the width target goes."""
        return self.grip_N / GRIPPER_N_m


class Settled:
    """Counts how long something has been so."""

    def __init__(self) -> None:
        self._steps = 0

    def __call__(self, now: bool) -> bool:
        """Return whether it has been so for ``SETTLE_steps``."""
        self._steps = self._steps + 1 if now else 0
        return self._steps >= SETTLE_steps


class Grip(Protocol):
    """Chooses the width, feeling nothing."""

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Return the next width target and whether the grasp should be made."""

    def hold(self, target_m: float, measured: np.ndarray) -> float:
        """Return the next width target while carrying and wiping."""


class Press(Protocol):
    """Chooses the height over the board, feeling nothing."""

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Return the next z target and whether the eraser should press by now."""

    def press(self, target_m: float, measured: np.ndarray) -> float:
        """Return the next z target while wiping."""


class NominalGrip:
    """Closes to the nominal eraser's width, less what the grip takes; waits instead of feeling."""

    def __init__(self, layout: Layout, settings: BlindSettings) -> None:
        self._width_m = layout.eraser_width_m - settings.grip_depth_m
        self._settled = Settled()

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Close to the nominal width, wait for the gripper to settle."""
        nxt = max(self._width_m, target_m - CLOSING_m_s / CONTROL_HZ)
        return nxt, self._settled(nxt == self._width_m)

    def hold(self, target_m: float, measured: np.ndarray) -> float:
        """Keep the width."""
        return target_m


class NominalPress:
    """Goes to the nominal board's height, less what the press takes; waits instead of feeling."""

    def __init__(self, layout: Layout, settings: BlindSettings) -> None:
        self._layout = layout
        self._z_m = layout.board_height_m + layout.grasp_height_m - settings.press_depth_m
        self._settled = Settled()

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Go to the nominal depth, wait for the arm to settle."""
        nxt = max(self._z_m, target_m - lowering_speed(target_m, self._layout) / CONTROL_HZ)
        return nxt, self._settled(nxt == self._z_m)

    def press(self, target_m: float, measured: np.ndarray) -> float:
        """Keep the height."""
        return target_m


class MeasuredGrip:
    """Targets a fixed distance inside the *measured* width: a force command, if the gripper's stiffness were known."""

    STALLED = 0.9  # share of that distance by which the width lags when the eraser stops it

    def __init__(self, layout: Layout, settings: BlindSettings) -> None:
        self._depth_m = settings.grip_depth_m
        self._settled = Settled()

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Close until the width stops following, then hold a fixed distance inside it."""
        nxt = max(measured[4] - self._depth_m, target_m - CLOSING_m_s / CONTROL_HZ)
        return float(nxt), self._settled(measured[4] - target_m > self.STALLED * self._depth_m)

    def hold(self, target_m: float, measured: np.ndarray) -> float:
        """Stay a fixed distance inside the measured width."""
        return float(measured[4] - self._depth_m)


class MeasuredPress:
    """Targets a fixed distance below the *measured* height: a force command, if the arm's stiffness were known.

    Contact shows as lag: the measured height stops following the target.
    """

    LAG_m = 0.0035  # beyond the free-air lag of slow lowering
    STEP_m = 0.001  # fastest change of the target while wiping, per step

    def __init__(self, layout: Layout, settings: BlindSettings) -> None:
        self._layout, self._depth_m = layout, settings.press_depth_m
        self._settled = Settled()

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Go down until the tool lags behind, then press by a fixed distance."""
        near = target_m < self._layout.board_height_m + self._layout.grasp_height_m + CLEARANCE_m
        touches = near and measured[2] - target_m > self.LAG_m
        pressed = self._settled(touches)
        if not touches:
            return target_m - lowering_speed(target_m, self._layout) / CONTROL_HZ, False
        return float(max(measured[2] - self._depth_m, target_m - SLOW_m_s / CONTROL_HZ)), pressed

    def press(self, target_m: float, measured: np.ndarray) -> float:
        """Stay a fixed distance below the measured height."""
        wanted_m = measured[2] - self._depth_m
        return float(target_m + np.clip(wanted_m - target_m, -self.STEP_m, self.STEP_m))


class BlindHands:
    """A grip and a press that feel nothing."""

    def __init__(self, grip: Grip, press: Press) -> None:
        self.close, self.hold = grip.close, grip.hold
        self.lower, self.press = press.lower, press.press

    def lost(self) -> bool:
        """Return False: a board that is lost looks like a soft arm."""
        return False


Style = tuple[Callable[[Layout, BlindSettings], Grip], Callable[[Layout, BlindSettings], Press]]
STYLES: dict[str, Style] = {
    "open_loop": (NominalGrip, NominalPress),
    "measured_relative": (MeasuredGrip, MeasuredPress),
    "measured_press": (NominalGrip, MeasuredPress),
}


def blind_hands(style: str, layout: Layout, settings: BlindSettings) -> BlindHands:
    """Return the hands of one of ``STYLES``."""
    grip, press = STYLES[style]
    return BlindHands(grip(layout, settings), press(layout, settings))
