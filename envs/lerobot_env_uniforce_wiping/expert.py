"""The scripted expert: reads the pads' true wrench with noise and the ink that is left.

It knows the nominal layout only.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from lerobot_env_uniforce_wiping.levels import CONTROL_HZ, Layout, Level
from lerobot_env_uniforce_wiping.sequence import Pace, Regulator, WipeSequence, look_back
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, expected

if TYPE_CHECKING:
    from lerobot_env_uniforce_wiping.env import WipeEnv

FingersUsed = Literal["both", "left", "right"]
FINGERS_USED: dict[str, tuple[Finger, ...]] = {
    "both": FINGERS,
    "left": ("left",),
    "right": ("right",),
}
GRAVITY_m_s2 = 9.81
CLEARANCE_m = 0.008  # above the nominal contact height, where lowering slows down
FAST_m_s = 0.050  # fastest lowering
SLOW_m_s = 0.018  # slowest lowering
LOWERING_GAIN = 3.5  # 1/s: speed per distance left above the clearance
CLOSING_m_s = 0.040  # gripper in free air
# once a hand that holds by force has the object, its width target lies this far inside it. With
# 8 mm policies stopped closing at the first touch, and the tool hung by 3 N
INSIDE_m = 0.02


def lowering_speed(target_m: float, layout: Layout) -> float:
    """Return the speed, m/s: fast in free air, slow where the board may be, changing smoothly."""
    height = target_m - (layout.board_height_m + layout.grasp_height_m + CLEARANCE_m)
    return float(np.clip(LOWERING_GAIN * height, SLOW_m_s, FAST_m_s))


@dataclass(frozen=True)
class ExpertNoise:
    """Noise scales of the expert; all zero makes it exact."""

    force_sd_N: float = 0.10  # white, per reading and axis
    force_gain_sd: float = 0.02  # per episode and finger
    press_sd_N: float = 0.15  # wanted press, per episode
    grip_sd_N: float = 0.10  # wanted grip, per episode
    pace_sd: float = 0.04  # speeds, per episode
    wander_m: float = 0.0008  # slow sideways drift of the hand
    # a policy's hand stops some millimetres too low or too high, and needs demos from there
    grasp_sd_m: float = 0.004  # height of the grasp on the eraser, per episode
    carry_sd_m: float = 0.005  # height of carrying, per episode
    # across and along the row: where the eraser is set down, from the row's beginning
    stray_sd_m: tuple[float, float] = (0.004, 0.008)


@dataclass(frozen=True)
class Contact:
    """Grip and press as estimated from the pads' wrenches."""

    grip_N: float  # normal force per finger
    press_N: float  # eraser on board


@dataclass(frozen=True)
class ExpertTouch:
    """How the expert regulates."""

    # 4 N are enough to wipe; 10 N are an event. A policy's peaks are 1.4 times its means
    press_N: float = 6.1
    # friction holds 1.2 times that press on the slipperiest pads. A flat gel reads a leaning eraser
    # a quarter too low, and 12 N are too deep for it (docs/experiments/tiny_policy.md)
    grip_N: float = 7.5
    lift_from: float = 0.85  # share of the wanted grip at which the grasp is made
    # share of the wanted press at which sweeping begins, still pressing harder: a policy that reads
    # its press too low must not wait for the rest in one place
    sweep_from: float = 0.5
    press_rate_m_s_N: float = 0.0035  # z speed per N of press error
    press_speed_m_s: float = 0.020  # fastest regulation
    grip_rate_m_s_N: float = 0.0030  # width speed per N of grip error
    contact_N: float = 1.2  # press that counts as touching the board


# against a pull that changes within a second: press in the middle of the band, regulated twice as
# fast, and a firmer grip (docs/experiments/scene.md)
AGAINST_PULL = ExpertTouch(press_N=6.0, grip_N=8.5, press_rate_m_s_N=0.008)


class TouchRegulator:
    """Regulate grip and press by touch, without memory.

    A hand that ``holds`` by its own force needs no grip regulation: a width inside the held object
    keeps the grasp.
    """

    def __init__(
        self,
        layout: Layout,
        contact: Callable[[], Contact],
        settings: ExpertTouch,
        holds: Callable[[], bool | None] = lambda: None,
    ) -> None:
        self._layout = layout
        self._contact = contact
        self._settings = settings
        self._holds = holds

    def close(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Close fast until a pad touches, then regulate; done at `lift_from` of the wanted grip.

        A hand says itself when it holds, but late, and a policy doesn't hear it: an expert that
        waits for it teaches the mean of waiting and lifting. The hand's word counts where the
        reading of grip stays too low.
        """
        s = self._settings
        is_gripped = self._contact().grip_N > s.lift_from * s.grip_N
        return self.hold(target_m, measured), is_gripped or bool(self._holds())

    def hold(self, target_m: float, measured: np.ndarray) -> float:
        """Move the width against the grip error, or inside the object where the hand holds it."""
        if self._holds() is not None:
            step_m = CLOSING_m_s / CONTROL_HZ
            return float(target_m + np.clip(measured[4] - INSIDE_m - target_m, -step_m, step_m))
        s = self._settings
        speed = np.clip(
            s.grip_rate_m_s_N * (self._contact().grip_N - s.grip_N), -CLOSING_m_s, CLOSING_m_s
        )
        return float(target_m + speed / CONTROL_HZ)

    def lower(self, target_m: float, measured: np.ndarray) -> tuple[float, bool]:
        """Go down to the board, then regulate; done at `sweep_from` of the wanted press."""
        press_N = self._contact().press_N
        s = self._settings
        if press_N < s.contact_N:
            return target_m - lowering_speed(target_m, self._layout) / CONTROL_HZ, False
        return self.press(target_m, measured), press_N > s.sweep_from * s.press_N

    def press(self, target_m: float, measured: np.ndarray) -> float:
        """Move z against the press error."""
        s = self._settings
        limit = s.press_speed_m_s
        speed = np.clip(s.press_rate_m_s_N * (self._contact().press_N - s.press_N), -limit, limit)
        return float(target_m + speed / CONTROL_HZ)

    def lost(self) -> bool:
        """Return whether the press is below what counts as touching the board."""
        return self._contact().press_N < self._settings.contact_N


class WipeExpert:
    """``reset(env)`` at each episode's start, then ``act(env)`` before each step.

    Args:
        fingers: which pads it reads.
        noise: drawn from the scene's seed, so that an episode repeats exactly.
        settings: set points and rates of its regulation; None: what the level needs.
        late_steps: delay of its force reading, control steps. It must match the policy's, or
            corrections come out a third too small (docs/experiments/tiny_policy.md).
    """

    def __init__(
        self,
        fingers: FingersUsed = "both",
        noise: ExpertNoise | None = None,
        settings: ExpertTouch | None = None,
        late_steps: int = 0,
    ) -> None:
        if fingers not in FINGERS_USED:
            raise ContractError(
                expected("fingers", " | ".join(FINGERS_USED), repr(fingers), "Name one.")
            )
        self.fingers = FINGERS_USED[fingers]
        self.noise = noise or ExpertNoise()
        self._given = settings
        self._felt: deque[Contact] = deque(maxlen=late_steps + 1)

    def reset(self, env: WipeEnv) -> None:
        """Start a new episode: draw this run's pace, set points and sensor gains."""
        rng = self._rng = np.random.default_rng([env.scene.seed, 4242])
        n = self.noise
        level = env.scene.level
        self.settings = self._given or (AGAINST_PULL if level.pull else ExpertTouch())
        self._gain: dict[Finger, float] = {}
        for finger in FINGERS:
            self._gain[finger] = 1 + n.force_gain_sd * rng.standard_normal()
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
        self._phase_rad = rng.uniform(0, 2 * np.pi, 2)
        self._clock = 0
        self._contact = Contact(0.0, 0.0)
        self._felt.clear()
        level = self._own_heights(level)
        self._weight_N = level.layout.eraser_mass_kg * GRAVITY_m_s2
        self._holds = lambda: env.sim.gripper.holds
        regulator = self._regulator(level.layout, press, grip)
        start = env.state.astype(np.float64)
        self._sequence = WipeSequence(
            level, regulator, start, lambda: look_back(env), pace, self._stray
        )

    def _stray(self) -> np.ndarray:
        """Draw by how much the hand arrives beside a row, (2,) m."""
        return np.clip(self._rng.standard_normal(2), -2, 2) * self.noise.stray_sd_m

    def _own_heights(self, level: Level) -> Level:
        """Return the level with this run's own heights of grasp and carrying."""
        layout = level.layout
        n = self.noise
        grasp, carry = np.clip(self._rng.standard_normal(2), -2, 2) * (n.grasp_sd_m, n.carry_sd_m)
        own = replace(
            layout,
            grasp_height_m=layout.grasp_height_m + float(grasp),
            carry_height_m=layout.carry_height_m + float(carry),
        )
        return replace(level, layout=own)

    def _regulator(self, layout: Layout, press_N: float, grip_N: float) -> Regulator:
        wanted = replace(self.settings, press_N=press_N, grip_N=grip_N)
        return TouchRegulator(layout, lambda: self._contact, wanted, self._holds)

    @property
    def phase(self) -> str:
        """Current phase, a word of ``WipeSequence``."""
        return self._sequence.phase

    def act(self, env: WipeEnv) -> np.ndarray:
        """Return the next absolute target (5,) float32."""
        self._felt.append(self._estimate(self._feel(env)))
        self._contact = self._felt[0]
        self._clock += 1
        action = self._sequence.next(env.state.astype(np.float64))
        action[:2] += self.noise.wander_m * np.sin(self._clock * 0.05 + self._phase_rad)
        return action.astype(np.float32)

    def _feel(self, env: WipeEnv) -> dict[Finger, np.ndarray]:
        """Return what the pads say; here the truth."""
        return env.true_wrench()

    def _estimate(self, wrench: dict[Finger, np.ndarray]) -> Contact:
        """Estimate grip and press from the pads it may use; one pad stands for both."""
        noisy = []
        for finger in self.fingers:
            noise = self.noise.force_sd_N * self._rng.standard_normal(3)
            noisy.append(wrench[finger][:3] * self._gain[finger] + noise)
        _, up, grip = np.mean(noisy, axis=0)
        return Contact(grip_N=float(grip), press_N=float(self._weight_N - 2 * up))
