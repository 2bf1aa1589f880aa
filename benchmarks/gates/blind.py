"""Scripts without touch: the expert's own sequence, grip and press from positions."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lerobot_env_uniforce_wiping.env import WipeEnv
from lerobot_env_uniforce_wiping.expert import CLEARANCE_m, CLOSING_m_s, SLOW_m_s, lowering_speed
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ, Layout
from lerobot_env_uniforce_wiping.mjcf import GRIPPER_N_m, STIFFNESS_N_m
from lerobot_env_uniforce_wiping.sequence import Regulator, WipeSequence, look_back

SETTLE_steps = 12  # waited at a position before the next phase
STALLED = 0.9  # share of the grip's distance by which the width lags when the eraser stops it
LAG_m = 0.0035  # of the height on contact, beyond the free-air lag of slow lowering
STEP_m = 0.001  # fastest change of the z target while wiping, per step


@dataclass(frozen=True)
class BlindSettings:
    """Set points of a script without touch, turned into positions by nominal stiffnesses."""

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
    """Whether something has been so for ``SETTLE_steps``."""

    def __init__(self) -> None:
        self._steps = 0

    def __call__(self, now: bool) -> bool:
        self._steps = self._steps + 1 if now else 0
        return self._steps >= SETTLE_steps


class OpenLoopRegulator:
    """Goes to the nominal eraser's width and board's height, less what grip and press take."""

    def __init__(self, layout: Layout, settings: BlindSettings) -> None:
        self._layout = layout
        self._width_m = layout.eraser_width_m - settings.grip_depth_m
        self._z_m = layout.board_height_m + layout.grasp_height_m - settings.press_depth_m
        self._closed, self._lowered = Settled(), Settled()

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        nxt = max(self._width_m, target_m - CLOSING_m_s / CONTROL_HZ)
        return nxt, self._closed(nxt == self._width_m)

    def hold(self, target_m: float, measured: np.ndarray) -> float:
        return target_m

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        nxt = max(self._z_m, target_m - lowering_speed(target_m, self._layout) / CONTROL_HZ)
        return nxt, self._lowered(nxt == self._z_m)

    def press(self, target_m: float, measured: np.ndarray) -> float:
        return target_m

    def lost(self) -> bool:
        """Return False: a board that is lost looks like a soft arm."""
        return False


class MeasuredPress(OpenLoopRegulator):
    """Targets a fixed distance below the *measured* height: a force, if K were known."""

    def __init__(self, layout: Layout, settings: BlindSettings) -> None:
        super().__init__(layout, settings)
        self._depth_m = settings.press_depth_m

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        near = target_m < self._layout.board_height_m + self._layout.grasp_height_m + CLEARANCE_m
        touches = near and measured[2] - target_m > LAG_m
        pressed = self._lowered(touches)
        if not touches:
            return target_m - lowering_speed(target_m, self._layout) / CONTROL_HZ, False
        return float(max(measured[2] - self._depth_m, target_m - SLOW_m_s / CONTROL_HZ)), pressed

    def press(self, target_m: float, measured: np.ndarray) -> float:
        wanted_m = measured[2] - self._depth_m
        return float(target_m + np.clip(wanted_m - target_m, -STEP_m, STEP_m))


class MeasuredRelative(MeasuredPress):
    """Besides, targets a fixed distance inside the *measured* width: a force, if K were known."""

    def __init__(self, layout: Layout, settings: BlindSettings) -> None:
        super().__init__(layout, settings)
        self._inside_m = settings.grip_depth_m

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        nxt = max(measured[4] - self._inside_m, target_m - CLOSING_m_s / CONTROL_HZ)
        return float(nxt), self._closed(measured[4] - target_m > STALLED * self._inside_m)

    def hold(self, target_m: float, measured: np.ndarray) -> float:
        return float(measured[4] - self._inside_m)


class BlindScript:
    """The expert's own sequence and layout, without touch; ``style`` makes its regulator."""

    def __init__(
        self,
        settings: BlindSettings,
        style: Callable[[Layout, BlindSettings], Regulator] = OpenLoopRegulator,
    ) -> None:
        self._settings, self._style = settings, style

    def reset(self, env: WipeEnv) -> None:
        regulator, start = (
            self._style(env.level.layout, self._settings),
            env.state.astype(np.float64),
        )
        self._sequence = WipeSequence(env.level, regulator, start, lambda: look_back(env))

    @property
    def phase(self) -> str:
        return self._sequence.phase

    def act(self, env: WipeEnv) -> np.ndarray:
        """Return the next absolute target (5,) float32 from the measured state alone."""
        return self._sequence.next(env.state.astype(np.float64)).astype(np.float32)
