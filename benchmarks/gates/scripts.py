"""Scripts without touch, cleverer than the scene's own: they identify stiffness or remember."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.gates.blind import BlindScript, BlindSettings, MeasuredPress, MeasuredRelative
from benchmarks.gates.readings import FEELS_s
from lerobot_env_uniforce_wiping.env import WipeEnv
from lerobot_env_uniforce_wiping.expert import Contact, ExpertTouch, TouchRegulator, WipeExpert
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ, Layout
from lerobot_env_uniforce_wiping.mjcf import GRIPPER_N_m, STIFFNESS_N_m
from lerobot_env_uniforce_wiping.sequence import LOOKS_BACK, Regulator, WipeSequence, look_back

HEIGHT_GAIN = 4.0  # 1/s: how fast a kept height is regulated
STEADY_STEPS = 12  # of a speed, after which the lag is that speed's
HARDER_N = 1.5  # more press after each look at ink that is left


@dataclass(frozen=True)
class LagLaw:
    """Stiffness, fitted on other scenes: K = nominal · exp(a + b · log(lag / (speed · 1 s)))."""

    a: float
    b: float

    def stiffness(self, nominal_N_m: float, lag_s: float) -> float:
        """Return the stiffness that belongs to such a lag, in seconds of the target's motion."""
        return float(nominal_N_m * np.exp(self.a + self.b * np.log(np.clip(lag_s, 1e-3, 1.0))))


class LagMeter:
    """The lag of a measured number behind its steadily moving target, as seconds of that motion."""

    def __init__(self) -> None:
        self._before, self._steady = np.nan, 0
        self.lags_s: list[float] = []

    def __call__(self, target_m: float, measured_m: float) -> None:
        speed = (target_m - self._before) * CONTROL_HZ
        moves = abs(speed) > 0.01
        self._steady = self._steady + 1 if moves and self._same(speed) else 0
        self._before, self._speed = target_m, speed
        if self._steady >= STEADY_STEPS:
            self.lags_s.append(abs(target_m - measured_m) / abs(speed))

    def _same(self, speed: float) -> bool:
        return abs(speed - getattr(self, "_speed", speed)) < 0.2 * abs(speed)

    @property
    def lag_s(self) -> float | None:
        """Return the median, None before a steady motion."""
        return float(np.median(self.lags_s)) if self.lags_s else None


class LagIdentifying(MeasuredRelative):
    """Reads the stiffness off the lag in free air, and sets forces as stiffness times distance."""

    laws: tuple[LagLaw, LagLaw] = (LagLaw(0.0, 0.0), LagLaw(0.0, 0.0))  # arm, gripper

    def __init__(self, layout: Layout, settings: BlindSettings) -> None:
        super().__init__(layout, settings)
        self._settings = settings
        self.arm, self.gripper = LagMeter(), LagMeter()

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        self.gripper(target_m, measured[4])
        if (lag_s := self.gripper.lag_s) is not None:
            self._inside_m = self._settings.grip_N / self.laws[1].stiffness(GRIPPER_N_m, lag_s)
        return super().close(target_m, measured)

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        self.arm(target_m, measured[2])
        if (lag_s := self.arm.lag_s) is not None:
            self._depth_m = self._settings.press_N / self.laws[0].stiffness(STIFFNESS_N_m[2], lag_s)
        return super().lower(target_m, measured)


class HarderEachLook(BlindScript):
    """Presses harder each time it sees ink that is left."""

    def reset(self, env: WipeEnv) -> None:
        regulator = self._style(env.level.layout, self._settings)

        def look() -> float | None:
            seen = look_back(env)
            if seen is not None and isinstance(regulator, MeasuredPress):
                regulator._depth_m += HARDER_N / STIFFNESS_N_m[2]
            return seen

        self._sequence = WipeSequence(env.level, regulator, env.state.astype(np.float64), look)
        self._sequence._looks_left = LOOKS_BACK


class Keeping(TouchRegulator):
    """Feels half a second of wiping, then keeps the target's depth, or the height the hand had."""

    def __init__(
        self,
        layout: Layout,
        contact: Callable[[], Contact],
        settings: ExpertTouch,
        holds: Callable[[], bool | None],
        keeps_height: bool,
    ) -> None:
        super().__init__(layout, contact, settings, holds)
        self._keeps_height, self._felt, self._height_m = keeps_height, 0, np.nan

    @property
    def _feels(self) -> bool:
        return self._felt < FEELS_s * CONTROL_HZ

    def press(self, target_m: float, measured: np.ndarray) -> float:
        if self._feels:
            self._felt += 1
            self._height_m = float(measured[2])
            return super().press(target_m, measured)
        if not self._keeps_height:
            return target_m
        return float(target_m + HEIGHT_GAIN * (self._height_m - measured[2]) / CONTROL_HZ)

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        if self._feels:
            return super().lower(target_m, measured)
        step_m = np.clip(self._height_m - measured[2], -0.02, 0.02) / CONTROL_HZ
        return float(target_m + step_m), bool(abs(self._height_m - measured[2]) < 0.001)

    def lost(self) -> bool:
        return self._feels and super().lost()


class KeepingExpert(WipeExpert):
    """The expert who stops feeling half a second into the wipe."""

    def __init__(self, keeps_height: bool) -> None:
        super().__init__()
        self._keeps_height = keeps_height

    def _regulator(self, layout: Layout, press_N: float, grip_N: float) -> Regulator:
        wanted = replace(self.settings, press_N=press_N, grip_N=grip_N)
        return Keeping(layout, lambda: self._contact, wanted, self._holds, self._keeps_height)
