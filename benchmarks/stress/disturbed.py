"""Faults of the arm, the scene and the task, where the sensors are as they were."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.stress.operators import Operator
from lerobot_env_uniforce_wiping import SceneParams, WipeEnv
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from lerobot_env_uniforce_wiping.touch import PadImages
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.evaluation.episode import WIPING_PHASE

PUSH_EVERY = round(2 * CONTROL_HZ)
PUSH_STEPS = round(0.2 * CONTROL_HZ)
EXCHANGE_AFTER = round(0.5 * CONTROL_HZ)  # steps of wiping
WORDINGS = (  # none of them was demonstrated; from close to far
    "wipe the whiteboard with 6 newtons",
    "please clean the board, pressing with 6 N",
    "remove the writing using about six newtons",
    "make the board blank again",
    "pick up the cube",
)


EXCHANGED = "X1 unit exchanged in mid-wipe"  # of TacTips


@dataclass(frozen=True)
class Disturbance:
    """Differences from the usual episode."""

    scene: Callable[[SceneParams], SceneParams] = lambda scene: scene
    late_steps: int = 0  # actions are executed so much later
    push_N: float = 0.0  # on the hand, for .2 s every 2 s, in a direction drawn each time
    task: str = ""  # said instead of the scene's text
    # worn right from half a second of wiping on, with its own reference; the pad's springs stay
    exchanged: str = ""


class DisturbedEnv(WipeEnv):
    """The wiping scene with a disturbance; everything else as ``WipeEnv``."""

    def __init__(self, disturbance: Disturbance, *usual: Any, **options: Any) -> None:
        super().__init__(*usual, **options)
        self._disturbance = disturbance

    def scene_of(self, seed: int) -> SceneParams:
        return self._disturbance.scene(super().scene_of(seed))

    def start(self, seed: int) -> None:
        """Build the scene of ``seed`` and say the task in the disturbance's words."""
        super().start(seed)
        self.task = self.task_description = self._disturbance.task or self.task
        self._waiting: deque[np.ndarray] = deque()
        self._wiped = 0
        self._rng = np.random.default_rng([seed, 47])

    def advance(self, action: np.ndarray) -> bool:
        """Take one step, late and pushed as the disturbance says."""
        self._waiting.append(action)
        due = self.sim.target.copy()
        if len(self._waiting) > self._disturbance.late_steps:
            due = self._waiting.popleft()
        self._push()
        over = super().advance(due)
        self._wiped += self.phase == WIPING_PHASE
        if self._wiped == EXCHANGE_AFTER and self._disturbance.exchanged:
            self._exchange()
            self._wiped += 1
        return over

    def _push(self) -> None:
        step = self._steps % PUSH_EVERY
        if step == 0:
            direction = self._rng.standard_normal(3)
            self._next_push_N = self._disturbance.push_N * direction / np.linalg.norm(direction)
        self.sim.push_N = np.zeros(3)
        if step >= PUSH_EVERY - PUSH_STEPS:
            self.sim.push_N = self._next_push_N

    def _exchange(self) -> None:
        if "right" in self._touch:
            seed = self.scene.seed
            unit = wear(self._disturbance.exchanged)(seed)
            self._touch["right"] = PadImages(unit, "right", seed + 1)
            self._follow()


@dataclass(frozen=True)
class SceneOperator(Operator):
    """A disturbance under an id, with its doses."""

    disturb: Callable[[float], Disturbance] = lambda dose: Disturbance()
    in_words: str = ""

    @property
    def unit(self) -> str:
        return self.in_words


def _scaled(*names: str) -> Callable[[float], Disturbance]:
    def disturb(factor: float) -> Disturbance:
        def change(scene: SceneParams) -> SceneParams:
            return replace(scene, **{name: _times(getattr(scene, name), factor) for name in names})

        return Disturbance(scene=change)

    return disturb


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(part * factor for part in value)
    return value * factor


def _hidden(name: str, sd: str) -> Callable[[float], Disturbance]:
    def disturb(factor: float) -> Disturbance:
        def change(scene: SceneParams) -> SceneParams:
            usual = getattr(scene.level, name)
            more = replace(usual, **{sd: getattr(usual, sd) * factor})
            return replace(scene, level=replace(scene.level, **{name: more}))

        return Disturbance(scene=change)

    return disturb


def _wider(more_mm: float) -> Disturbance:
    return Disturbance(scene=lambda s: replace(s, eraser_width_m=s.eraser_width_m + more_mm / 1000))


def _said(number: float) -> Disturbance:
    return Disturbance(task=WORDINGS[round(number) - 1] if number else "")


def _operator(
    unit: str, doses: tuple[float, ...], benign: float, disturb: Callable[[float], Disturbance]
) -> SceneOperator:
    return SceneOperator("", doses, benign, doses[2], disturb, unit)


SCENE_OPERATORS = {
    "P1 late actions": _operator(
        "ms",
        (33, 67, 133, 200, 300),
        0,
        lambda ms: Disturbance(late_steps=round(ms / 1000 * CONTROL_HZ)),
    ),
    "P2 pushed arm": _operator("N", (2, 4, 8, 12, 16), 0, lambda N: Disturbance(push_N=N)),
    "P3 stronger pull": _operator("×", (1.25, 1.5, 2, 2.5, 3), 1, _hidden("pull", "sd_N")),
    "B1 rougher board": _operator("×", (1.25, 1.5, 2, 2.5, 3), 1, _hidden("uneven", "sd_m")),
    "B2 board friction": _operator("×", (1.2, 1.5, 2, 2.5, 3), 1, _scaled("board_friction")),
    "B3 pads slip": _operator("×", (0.9, 0.8, 0.7, 0.6, 0.5), 1, _scaled("pad_friction")),
    "E1 heavier eraser": _operator("×", (1.5, 2, 3, 4, 6), 1, _scaled("eraser_mass_kg")),
    "E2 wider eraser": _operator("mm", (4, 6, 8, 10, 12), 0, _wider),
    EXCHANGED: _operator(
        "unit", (2, 3, 4, 5, 6), 1, lambda unit: Disturbance(exchanged=f"tactip:{unit:g}")
    ),
    "W1 other words": _operator("number of the text", (1, 2, 3, 4, 5), 0, _said),
}
