"""More scripts without touch: grip and press at a fixed distance from the *measured* width and height."""

from collections.abc import Callable

import numpy as np

from lerobot_env_uniforce_wiping.blind import (
    BlindSettings,
    CLEARANCE_m,
    CLOSING_m_s,
    OpenLoopRegulator,
    SLOW_m_s,
    lowering_speed,
)
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ, Layout
from lerobot_env_uniforce_wiping.sequence import Regulator

STALLED = 0.9  # share of the grip's distance by which the width lags when the eraser stops it
LAG_m = 0.0035  # of the height on contact, beyond the free-air lag of slow lowering
STEP_m = 0.001  # fastest change of the z target while wiping, per step


class MeasuredPress(OpenLoopRegulator):
    """Targets a fixed distance below the *measured* height: a force command, if the arm's stiffness were known.

    Contact shows as lag: the measured height stops following the target.
    """

    def __init__(self, layout: Layout, settings: BlindSettings) -> None:
        super().__init__(layout, settings)
        self._depth_m = settings.press_depth_m

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Go down until the tool lags behind, then press by a fixed distance."""
        near = target_m < self._layout.board_height_m + self._layout.grasp_height_m + CLEARANCE_m
        touches = near and measured[2] - target_m > LAG_m
        pressed = self._lowered(touches)
        if not touches:
            return target_m - lowering_speed(target_m, self._layout) / CONTROL_HZ, False
        return float(max(measured[2] - self._depth_m, target_m - SLOW_m_s / CONTROL_HZ)), pressed

    def press(self, target_m: float, measured: np.ndarray) -> float:
        """Stay a fixed distance below the measured height."""
        wanted_m = measured[2] - self._depth_m
        return float(target_m + np.clip(wanted_m - target_m, -STEP_m, STEP_m))


class MeasuredRelative(MeasuredPress):
    """Besides, targets a fixed distance inside the *measured* width: a force, if the gripper's stiffness were known."""

    def __init__(self, layout: Layout, settings: BlindSettings) -> None:
        super().__init__(layout, settings)
        self._inside_m = settings.grip_depth_m

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Close until the width stops following, then hold a fixed distance inside it."""
        nxt = max(measured[4] - self._inside_m, target_m - CLOSING_m_s / CONTROL_HZ)
        return float(nxt), self._closed(measured[4] - target_m > STALLED * self._inside_m)

    def hold(self, target_m: float, measured: np.ndarray) -> float:
        """Stay a fixed distance inside the measured width."""
        return float(measured[4] - self._inside_m)


STYLES: dict[str, Callable[[Layout, BlindSettings], Regulator]] = {
    "open_loop": OpenLoopRegulator,
    "measured_relative": MeasuredRelative,
    "measured_press": MeasuredPress,
}
