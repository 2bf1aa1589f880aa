"""Disturbances of a demonstration, so that demos hold recoveries: a nudged hand, ink that comes back.

The executed target is the expert's target plus a slow hidden offset. The expert measures its effect and corrects; the
dataset stores what the expert *commanded*, so every label is a correction and never the nudge itself (the idea of
DART: Laskey et al. 2017, "Noise Injection for Robust Imitation Learning").
"""

from dataclasses import dataclass

import numpy as np

from lerobot_env_uniforce_wiping.ink import InkField
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from lerobot_env_uniforce_wiping.sequence import Z


@dataclass(frozen=True)
class Push:
    """A push of the hand along z that decays."""

    by_m: tuple[float, float]  # drawn evenly; up is positive
    per_s: float  # how often one begins
    fall_s: float  # time constant of its decay


@dataclass(frozen=True)
class NudgeSettings:
    """Spread of the offset per axis; an offset in z or width is a force through the arm's or gripper's stiffness."""

    sd: tuple[float, float, float, float, float] = (0.0012, 0.0012, 0.0028, 0.010, 0.0009)  # m, m, m, rad, m
    # 2.8 mm · 800 N/m ≈ 2.2 N: presses of 10 N and more occur, and are corrected within half a second. With less, a
    # swapped finger's error of the press is as large as its spread in demos, and a policy responds to it less.
    # .9 mm · 1200 N/m ≈ 1.1 N, of which regulation leaves half: with less, a finger's error of the grip is larger, and
    # a policy then grips by the measured width; with 1.2 mm every second demo is no longer clean
    correlation_s: float = 0.6  # about the time the expert needs to correct a press
    # a soft arm gives way by 19 mm at the usual press; slow: the press that comes back with it stays within 2 N
    wiping: Push = Push((0.004, 0.022), per_s=0.08, fall_s=4.0)
    # a policy that misses the moment to grip goes on sinking, to where demos never were
    descending: Push = Push((-0.025, 0.020), per_s=0.8, fall_s=1.5)
    in_air: Push = Push((-0.015, 0.045), per_s=0.5, fall_s=1.2)
    # back down to the wiped board: an undisturbed departure takes a third of a second, too short to learn from
    leaving: Push = Push((-0.012, -0.003), per_s=2.0, fall_s=1.0)
    rise_s: float = 0.1  # of a push

    def push(self, phase: str) -> Push | None:
        """Return what may happen in a phase of the sequence."""
        by_phase = dict.fromkeys(("descend", "close"), self.descending)
        by_phase |= dict.fromkeys(("lift", "carry"), self.in_air)
        by_phase |= {"wipe": self.wiping, "leave": self.leaving}
        return by_phase.get(phase)


class Nudge:
    """Ornstein-Uhlenbeck offset of the executed target, and a push along z now and then.

    Without pushes while wiping demos lose the board for moments at most, and a policy that begins a stroke in the air
    goes on so; without those in the air no demo returns from too high, and a policy that rises too far drifts; without
    those while leaving, one that leaves a clean board too slowly goes down again.

    Args:
        seed: the scene's; an episode repeats exactly.
        scale: 0 = none, 1 = as set.
        settings: spread and correlation time.
    """

    def __init__(self, seed: int, scale: float = 1.0, settings: NudgeSettings | None = None) -> None:
        settings = settings or NudgeSettings()
        self._rng, self._pushes = np.random.default_rng([seed, 777]), np.random.default_rng([seed, 778])
        self._sd = scale * np.array(settings.sd)
        self._keep = _kept(settings.correlation_s)
        self._settings, self._scale = settings, scale
        self._pushed_m = self._wanted_m = 0.0
        self._fall_s = settings.wiping.fall_s
        self.offset = np.zeros(len(self._sd))

    def apply(self, target: np.ndarray, phase: str = "") -> np.ndarray:
        """Return the (5,) float32 target the arm is really sent to, one step later each call.

        Args:
            target: what was commanded.
            phase: what the expert is doing (``sequence.PHASES``): it decides which push may begin.
        """
        kick = np.sqrt(1 - self._keep**2) * self._sd * self._rng.standard_normal(len(self._sd))
        self.offset = self._keep * self.offset + kick
        executed = target + self.offset
        executed[Z] += self._push(phase)
        return executed.astype(np.float32)

    def _push(self, phase: str) -> float:
        push, chance = self._settings.push(phase), self._pushes.random()
        self._wanted_m *= _kept(self._fall_s)
        if push and chance < push.per_s / CONTROL_HZ:
            self._wanted_m, self._fall_s = self._scale * self._pushes.uniform(*push.by_m), push.fall_s
        self._pushed_m += (1 - _kept(self._settings.rise_s)) * (self._wanted_m - self._pushed_m)
        return self._pushed_m


@dataclass(frozen=True)
class RewriteSettings:
    """When ink comes back to the board, and how much."""

    share: float = 0.7  # of the episodes; ink that the eraser still passes is wiped unnoticed
    after_s: tuple[float, float] = (3.5, 5.8)  # of wiping; the sweep takes six
    height_m: tuple[float, float] = (0.020, 0.040)  # along board x, of a writing 34 to 48 mm high
    length_m: tuple[float, float] = (0.030, 0.080)  # along board y, of a writing 70 to 100 mm long
    strength: tuple[float, float] = (0.4, 1.0)  # of the first ink: faint as a light stroke leaves it, or dark


class Rewrite:
    """In some episodes part of the writing comes back behind the eraser, for the expert to find when it looks back.

    Without it demos end with the first sweep, and a policy whose first sweep was too light lifts the eraser and stays
    there.

    Args:
        seed: the scene's; an episode repeats exactly.
        settings: when and how much.
    """

    def __init__(self, seed: int, settings: RewriteSettings | None = None) -> None:
        s = settings or RewriteSettings()
        rng = np.random.default_rng([seed, 779])
        wanted = rng.random() < s.share
        self._left_s = float(rng.uniform(*s.after_s)) if wanted else np.inf
        self._size_m = np.array([rng.uniform(*s.height_m), rng.uniform(*s.length_m)])
        self._place = rng.uniform(-0.3, 0.3, 2)  # of the whole writing's box
        self._strength = float(rng.uniform(*s.strength))

    def apply(self, ink: InkField, wiping: bool) -> None:
        """Write when its time has come; call once per step."""
        self._left_s -= wiping / CONTROL_HZ
        if self._left_s <= 0:
            self._left_s = np.inf
            center_m, extent_m = ink.written_box_m
            ink.rewrite(center_m + self._place * extent_m, self._size_m, self._strength)


def _kept(time_constant_s: float) -> float:
    """Return the share of an offset that is left after one control step."""
    return float(np.exp(-1 / (time_constant_s * CONTROL_HZ)))
