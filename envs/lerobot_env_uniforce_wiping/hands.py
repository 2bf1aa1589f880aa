"""Touching hands and blind hands: two ways to choose grip and press."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lerobot_env_uniforce_wiping.levels import Layout
from lerobot_env_uniforce_wiping.mjcf import GRIPPER_N_m, STIFFNESS_N_m
from lerobot_env_uniforce_wiping.simulation import CONTROL_HZ

CLEARANCE_m = 0.008  # above the nominal contact height, where lowering slows down
FAST_m_s, SLOW_m_s = 0.050, 0.018  # lowering
LOWERING_GAIN = 3.5  # 1/s: speed per distance left above the clearance
CLOSING_m_s = 0.040  # gripper in free air


@dataclass(frozen=True)
class Feel:
    """What a controller makes of the pad wrenches."""

    grip_N: float  # normal force per finger
    press_N: float  # eraser on board


@dataclass(frozen=True)
class TouchSettings:
    """How the expert regulates."""

    # every scene is wiped from 3 N on, 8.5 N make grasps slip, 10 N are an event; policies' means spread by a newton
    # and their peaks are 1.4 times the mean (docs/experiments/tiny_policy.md)
    press_N: float = 6.0
    # nothing slips from 8 N on (at 7 N of press) and no pad is too deep up to 9 (10: 3 scenes of 40); policies hold .4
    # to 1.4 N more than they were shown
    grip_N: float = 8.0
    lift_from: float = 0.85  # share of the wanted grip at which the grasp is made
    # share of the wanted press at which sweeping begins, still pressing harder: who reads his press too low must not
    # wait for the rest in one place
    sweep_from: float = 0.5
    press_rate_m_s_N: float = 0.0035  # z speed per N of press error
    press_speed_m_s: float = 0.020  # fastest regulation
    grip_rate_m_s_N: float = 0.0030  # width speed per N of grip error
    contact_N: float = 1.2  # felt press that counts as touching the board


def lowering_speed(target_m: float, layout: Layout) -> float:
    """Fast in free air, slow where the board may be, changing smoothly."""
    height = target_m - (layout.board_height_m + layout.grasp_height_m + CLEARANCE_m)
    return float(np.clip(LOWERING_GAIN * height, SLOW_m_s, FAST_m_s))


class TouchHands:
    """Regulates what it feels; keeps no memory beyond its own target."""

    def __init__(self, layout: Layout, feel: Callable[[], Feel], settings: TouchSettings) -> None:
        self._layout, self._feel, self._settings = layout, feel, settings

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Close fast until a pad feels something, then regulate; made at `lift_from` of the wanted grip."""
        s = self._settings
        return self.hold(target_m, measured), self._feel().grip_N > s.lift_from * s.grip_N

    def hold(self, target_m: float, measured: np.ndarray) -> float:
        """Move the width against the grip error."""
        s = self._settings
        speed = np.clip(s.grip_rate_m_s_N * (self._feel().grip_N - s.grip_N), -CLOSING_m_s, CLOSING_m_s)
        return float(target_m + speed / CONTROL_HZ)

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Go down until the board is felt, then regulate; sweep from `sweep_from` of the wanted press on."""
        felt, s = self._feel().press_N, self._settings
        if felt < s.contact_N:
            return target_m - lowering_speed(target_m, self._layout) / CONTROL_HZ, False
        return self.press(target_m, measured), felt > s.sweep_from * s.press_N

    def press(self, target_m: float, measured: np.ndarray) -> float:
        """Move z against the press error."""
        s = self._settings
        limit = s.press_speed_m_s
        speed = np.clip(s.press_rate_m_s_N * (self._feel().press_N - s.press_N), -limit, limit)
        return float(target_m + speed / CONTROL_HZ)

    def lost(self) -> bool:
        """Return whether less is felt than what counted as touching the board."""
        return self._feel().press_N < self._settings.contact_N


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


class BlindHands:
    """Hands that feel nothing."""

    def lost(self) -> bool:
        """Return False: a board that is lost looks like a soft arm."""
        return False


class OpenLoopHands(BlindHands):
    """Nominal eraser, nominal board, nominal stiffness; waits instead of feeling."""

    def __init__(self, layout: Layout, settings: BlindSettings, pads_m: float = 0.0) -> None:
        self._layout = layout
        self._width = layout.eraser_width_m - pads_m - settings.grip_depth_m
        self._z = layout.board_height_m + layout.grasp_height_m - settings.press_depth_m
        self._waited = 0

    def _wait(self, arrived: bool, steps: int) -> bool:
        self._waited = self._waited + 1 if arrived else 0
        return self._waited >= steps

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Close to the nominal width, wait for the gripper to settle."""
        nxt = max(self._width, target_m - CLOSING_m_s / CONTROL_HZ)
        return nxt, self._wait(nxt == self._width, 12)

    def hold(self, target_m: float, measured: np.ndarray) -> float:
        """Keep the width."""
        return target_m

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Go to the nominal depth, wait for the arm to settle."""
        nxt = max(self._z, target_m - lowering_speed(target_m, self._layout) / CONTROL_HZ)
        return nxt, self._wait(nxt == self._z, 12)

    def press(self, target_m: float, measured: np.ndarray) -> float:
        """Keep the height."""
        return target_m


class MeasuredRelativeHands(BlindHands):
    """Targets a fixed distance inside the *measured* pose: a force command, if stiffness were known.

    Contact shows as lag: the measured height stops following the target.
    """

    LAG_m = 0.0035  # beyond the free-air lag of slow lowering

    def __init__(self, layout: Layout, settings: BlindSettings) -> None:
        self._layout, self._settings, self._waited = layout, settings, 0

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Close until the width stops following, then hold a fixed distance inside it."""
        depth = self._settings.grip_depth_m
        nxt = max(measured[4] - depth, target_m - CLOSING_m_s / CONTROL_HZ)
        stalled = measured[4] - target_m > 0.9 * depth
        self._waited = self._waited + 1 if stalled else 0
        return float(nxt), self._waited >= 10

    def hold(self, target_m: float, measured: np.ndarray) -> float:
        """Stay a fixed distance inside the measured width."""
        return float(measured[4] - self._settings.grip_depth_m)

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Go down until the tool lags behind, then press by a fixed distance."""
        depth = self._settings.press_depth_m
        near = target_m < self._layout.board_height_m + self._layout.grasp_height_m + CLEARANCE_m
        if not (near and measured[2] - target_m > self.LAG_m):
            self._waited = 0
            return target_m - lowering_speed(target_m, self._layout) / CONTROL_HZ, False
        self._waited += 1
        nxt = max(measured[2] - depth, target_m - SLOW_m_s / CONTROL_HZ)
        return float(nxt), self._waited >= 12

    def press(self, target_m: float, measured: np.ndarray) -> float:
        """Stay a fixed distance below the measured height."""
        wanted = measured[2] - self._settings.press_depth_m
        return float(target_m + np.clip(wanted - target_m, -0.001, 0.001))
