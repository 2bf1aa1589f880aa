"""The scripted expert: feels the pads' true wrench with noise, sees ink that is left, knows only the nominal layout.

Its twin without touch (``fingers="none"``) runs the same sequence on nominal numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from lerobot_env_uniforce_wiping.blind_hands import BlindSettings, blind_hands
from lerobot_env_uniforce_wiping.hands import Feel, TouchHands, TouchSettings
from lerobot_env_uniforce_wiping.levels import Layout, Level
from lerobot_env_uniforce_wiping.look_back import look_back
from lerobot_env_uniforce_wiping.sequence import Hands, Pace, WipeSequence
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, expected

if TYPE_CHECKING:
    from lerobot_env_uniforce_wiping.env import WipeEnv

FingersUsed = Literal["both", "left", "right", "none"]
FINGERS_USED: dict[str, tuple[Finger, ...]] = {
    "both": FINGERS,
    "left": ("left",),
    "right": ("right",),
    "none": (),
}
GRAVITY_m_s2 = 9.81


@dataclass(frozen=True)
class ExpertNoise:
    """How unlike a machine the expert is; all zero makes it exact."""

    force_sd_N: float = 0.10  # white, per reading and axis
    force_gain_sd: float = 0.02  # per episode and finger
    press_sd_N: float = 0.15  # wanted press, per episode
    grip_sd_N: float = 0.10  # wanted grip, per episode
    pace_sd: float = 0.04  # speeds, per episode
    wander_m: float = 0.0008  # slow sideways drift of the hand
    # a policy's hand stops some millimetres too low or too high; without demos from there it is lost for good
    grasp_sd_m: float = 0.004  # height of the grasp on the eraser, per episode
    carry_sd_m: float = 0.005  # height of carrying, per episode
    # across and along the row, how far beside its beginning the eraser is carried to, each time: likewise
    stray_sd_m: tuple[float, float] = (0.004, 0.008)


class WipeExpert:
    """``reset(env)`` at each episode's start, then ``act(env)`` before each step.

    Args:
        fingers: which pads it feels.
        noise: its human side; drawn from the scene's seed, so that an episode repeats exactly.
        settings: set points and rates of its regulation.
    """

    def __init__(
        self,
        fingers: FingersUsed = "both",
        noise: ExpertNoise | None = None,
        settings: TouchSettings | None = None,
    ) -> None:
        if fingers not in FINGERS_USED:
            raise ContractError(expected("fingers", " | ".join(FINGERS_USED), repr(fingers), "Name one."))
        self.fingers = FINGERS_USED[fingers]
        self.noise = noise or ExpertNoise()
        self.settings = settings or TouchSettings()

    def reset(self, env: WipeEnv) -> None:
        """Start a new episode: draw this run's pace, set points and sensor gains."""
        rng = self._rng = np.random.default_rng([env.scene.seed, 4242])
        n = self.noise
        self._gain = {f: 1 + n.force_gain_sd * rng.standard_normal() for f in FINGERS}
        press = self.settings.press_N + n.press_sd_N * rng.standard_normal()
        grip = self.settings.grip_N + n.grip_sd_N * rng.standard_normal()
        slower = 1 - np.abs(n.pace_sd * rng.standard_normal(3))
        usual = Pace()
        pace = replace(
            usual,
            horizontal_m_s=usual.horizontal_m_s * slower[0],
            vertical_m_s=usual.vertical_m_s * slower[1],
            stroke_m_s=usual.stroke_m_s * slower[2],
        )
        self._phase_rad, self._clock = rng.uniform(0, 2 * np.pi, 2), 0
        self._felt = Feel(0.0, 0.0)
        level = self._own_heights(env.scene.level)
        self._weight_N = level.layout.eraser_mass_kg * GRAVITY_m_s2
        hands = self._hands(level.layout, press, grip)
        start = env.state.astype(np.float64)
        self._sequence = WipeSequence(level, hands, start, lambda: look_back(env), pace, self._stray)

    def _stray(self) -> np.ndarray:
        """Draw by how much the hand arrives beside a row, (2,) m."""
        return np.clip(self._rng.standard_normal(2), -2, 2) * self.noise.stray_sd_m

    def _own_heights(self, level: Level) -> Level:
        """Return the level as this run goes about it: grasped and carried a little higher or lower."""
        layout, n = level.layout, self.noise
        grasp, carry = np.clip(self._rng.standard_normal(2), -2, 2) * (n.grasp_sd_m, n.carry_sd_m)
        own = replace(
            layout,
            grasp_height_m=layout.grasp_height_m + float(grasp),
            carry_height_m=layout.carry_height_m + float(carry),
        )
        return replace(level, layout=own)

    def _hands(self, layout: Layout, press_N: float, grip_N: float) -> Hands:
        if not self.fingers:
            return blind_hands("open_loop", layout, BlindSettings(press_N, grip_N))
        wanted = replace(self.settings, press_N=press_N, grip_N=grip_N)
        return TouchHands(layout, lambda: self._felt, wanted)

    @property
    def phase(self) -> str:
        """What it is doing, one of ``sequence.PHASES``."""
        return self._sequence.phase

    def act(self, env: WipeEnv) -> np.ndarray:
        """Return the next absolute target (5,) float32."""
        if self.fingers:
            self._felt = self.feel(env.true_wrench())
        self._clock += 1
        action = self._sequence.next(env.state.astype(np.float64))
        action[:2] += self.noise.wander_m * np.sin(self._clock * 0.05 + self._phase_rad)
        return action.astype(np.float32)

    def feel(self, wrench: dict[Finger, np.ndarray]) -> Feel:
        """Estimate grip and press from the pads it may use; one pad stands for both."""
        noisy = [
            wrench[f][:3] * self._gain[f] + self.noise.force_sd_N * self._rng.standard_normal(3)
            for f in self.fingers
        ]
        _, up, grip = np.mean(noisy, axis=0)
        return Feel(grip_N=float(grip), press_N=float(self._weight_N - 2 * up))
