"""The benchmark's arms and the questions asked of them, fixed before any of them is scored.

Two rigs, the same right finger: GelSight left or uSkin left, TacTip right. V and V+T learn from both rigs' demos,
V+T+G and V+T+U from their own. V+G and V+U are the V+T checkpoint, its one slot filled by the other finger.
Both left pads are the same body to physics and cameras, so an arm whose left finger fills no slot does the same
on either rig and is rolled out on one (``tests/envs/test_touch.py``).
"""

from dataclasses import dataclass
from typing import Literal

from uniforce_vtla.contracts import Finger
from uniforce_vtla.evaluation.comparison import AtMostWorse


@dataclass(frozen=True)
class Arm:
    """One line of the table: which checkpoint, on which rig, and what was changed at rollout time.

    ``checkpoint`` is the name of a folder of checkpoints, or a script's of ``uniforce score``: expert | blind.
    """

    name: str
    checkpoint: str
    left: str
    right: str = "tactip"
    swap: str = ""
    control: Literal["", "masked", "shuffled"] = ""


@dataclass(frozen=True)
class Recipe:
    """What a checkpoint of the plan has of touch, from which fingers, and on which rigs' demos it is trained.

    ``rigs`` names the left finger's sensors. The rest is the policy's own ``recipe=scored``.
    """

    touch_input: str
    slots: tuple[tuple[str, Finger], ...] = (("touch0", "right"),)
    rigs: tuple[str, ...] = ("gelsight", "uskin")


_BOTH: tuple[tuple[str, Finger], ...] = (("touch0", "right"), ("touch1", "left"))
RECIPES = {
    "v": Recipe("none"),
    "vt": Recipe("latent"),
    "vtg": Recipe("latent", _BOTH, ("gelsight",)),
    "vtu": Recipe("latent", _BOTH, ("uskin",)),
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
