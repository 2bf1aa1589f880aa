"""Touching hands: grip and press regulated by what is felt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lerobot_env_uniforce_wiping.levels import Layout
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

    # 4 N are enough to wipe; 10 N are an event, and policies' peaks are 1.4 times their means, which spread by .7 N
    press_N: float = 6.1
    # friction holds 1.2 times that press on the slipperiest pads; a flat gel that is swapped in feels a leaning eraser
    # a quarter too lightly, and 12 N are too deep for it (docs/experiments/tiny_policy.md)
    grip_N: float = 7.5
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
