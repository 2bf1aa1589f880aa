"""The benchmark's arms and the questions asked of them, fixed before any of them is scored.

Two rigs, the same right finger: GelSight left or uSkin left, TacTip right. V and V+T learn from both rigs' demos,
V+T+G and V+T+U from their own. V+G and V+U are the V+T checkpoint, its one slot filled by the other finger.
Both left pads are the same body to physics and cameras, so an arm whose left finger fills no slot does the same
on either rig and is rolled out on one (``tests/envs/test_touch.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from uniforce_vtla.contracts import Finger
from uniforce_vtla.evaluation.comparison import AtMostWorse


@dataclass(frozen=True)
class Arm:
    """One line of the table: which checkpoint, on which rig, and what was changed at rollout time.

    ``checkpoint`` is the name of a folder of checkpoints, or a script's of ``uniforce-score``: expert | blind.
    """

    name: str
    checkpoint: str
    left: str
    right: str = "tactip"
    swap: str = ""
    control: Literal["", "masked", "shuffled"] = ""


@dataclass(frozen=True)
class Recipe:
    """How a checkpoint of the plan is trained: its touch input, with which fingers, on which rigs' demos.

    ``rigs`` names the left finger's sensors; ``touch_dropout`` None is the policy's own default. ``state_noise`` blurs
    the measured height by 6 mm and the width by 1.4 mm while training: boards lie higher or lower, erasers are wider or
    narrower, arms and grippers give way, so that a policy that trusts the pose strokes in the air, presses or grips too
    hard (docs/experiments/tiny_policy.md). V keeps both, having nothing else.
    ``sensor_transfer`` is the share of samples whose latents are mapped to those of another finger's sensor,
    ``touch_directions`` how many directions of a latent map are kept (0: all of it), ``touch_noise`` how much
    they are blurred while training, in units of what fingers of a grasp disagree by (None: the policy's own default).
    """

    touch_input: str
    slots: tuple[tuple[str, Finger], ...] = (("touch0", "right"),)
    rigs: tuple[str, ...] = ("gelsight", "uskin")
    touch_dropout: float | None = None
    state_noise: tuple[float, ...] = (0.0, 0.0, 0.2, 0.0, 0.1)  # of half the demos' range per axis
    sensor_transfer: float = 0.0
    touch_directions: int = 0
    touch_noise: float | None = None


_BOTH: tuple[tuple[str, Finger], ...] = (("touch0", "right"), ("touch1", "left"))
# V+T's touch is masked in a tenth of the samples, so that the masked control is inside its training distribution.
_HIDDEN = 0.1
# A fifth mapped to another sensor makes a head read the other finger's grip three times better and costs its own one
# nothing. Four directions hold grip and pull and nothing sideways, in which the fingers of one grasp may disagree by
# newtons, and each is blurred by as much as they disagree along it: without the last two steps a policy grips with 12 N
# where 9 are meant (docs/experiments/tiny_policy.md).
_LATENT = Recipe("latent", sensor_transfer=0.2, touch_directions=4, touch_noise=1.0)
RECIPES = {
    "v": Recipe("none", state_noise=()),
    "vt": replace(_LATENT, touch_dropout=_HIDDEN),
    "vtg": replace(_LATENT, slots=_BOTH, rigs=("gelsight",)),
    "vtu": replace(_LATENT, slots=_BOTH, rigs=("uskin",)),
    "wrench": Recipe("wrench", _BOTH),
    "descriptor": Recipe("descriptor"),
    "images": Recipe("marker_pair"),
}

ARMS = (
    Arm("expert", "expert", "gelsight"),
    Arm("best blind script", "blind", "gelsight"),
    Arm("V", "v", "gelsight"),
    Arm("V+T", "vt", "gelsight"),
    Arm("V+G", "vt", "gelsight", swap="touch0:left"),
    Arm("V+T+G", "vtg", "gelsight"),
    Arm("V+U", "vt", "uskin", swap="touch0:left"),
    Arm("V+T+U", "vtu", "uskin"),
    Arm("V+T+G on the uSkin rig", "vtg", "uskin"),
    Arm("V+T masked", "vt", "gelsight", control="masked"),
    Arm("V+T shuffled", "vt", "gelsight", control="shuffled"),
    Arm("true wrench", "wrench", "gelsight"),
    Arm("descriptor tokens", "descriptor", "gelsight"),
    Arm("descriptor tokens swapped", "descriptor", "gelsight", swap="touch0:left"),
    Arm("raw images", "images", "gelsight"),
    Arm("raw images swapped", "images", "gelsight", swap="touch0:left"),
)
# first succeeds more often than second; one family for Holm's correction
BETTER = (
    ("V+T", "V"),
    ("V+T", "best blind script"),
    ("V+G", "V"),
    ("V+U", "V"),
    ("V+T+G", "V"),
    ("V+T+U", "V"),
    ("raw images", "raw images swapped"),
)


AS_GOOD = (
    AtMostWorse("sensor swapped, nothing trained", "V+G", "V+T", 0.10),
    AtMostWorse("sensor swapped, nothing trained", "V+U", "V+T", 0.10),
    AtMostWorse("sensor swapped, nothing trained", "V+T+G on the uSkin rig", "V+T+G", 0.10),
    AtMostWorse("next to the expert", "V+T+G", "expert", 0.07),
    AtMostWorse("next to the expert", "V+T+U", "expert", 0.07),
    AtMostWorse("tokens next to the true wrench", "V+T+G", "true wrench", 0.08),
    AtMostWorse("tokens next to the true wrench", "V+T+U", "true wrench", 0.08),
    AtMostWorse("no better than none", "V", "V+T masked", 0.05),
    AtMostWorse("no better than none", "V", "V+T shuffled", 0.05),
)
