"""Plan of the swap ladder: rows, scenes and claims. Fixed before a final scene was scored.

How the policy was chosen stands in docs/experiments/swap.md. All demonstrations wear GelSight 1 on
the left finger and TacTip 1 on the right one, in the hand's rig. Every policy feels with both
fingers. The ladder exchanges the right one's sensor, and two rows exchange both. The arms stand
beside the paper's: V vision, T TacTip, G GelSight, U uSkin. A finger that an arm lacks is masked.

Checkpoints are folders ``<checkpoints>/<policy>/seed0`` …; all learn from the same demonstrations
with the same recipe.
"""

from dataclasses import dataclass
from typing import Literal

from benchmarks.calibrations import Fit, units
from benchmarks.ladder.comparison import AtMostWorse
from uniforce_cli.boundary import Gripper, Level

LEVEL: Level = "touch"
GRIPPER: Gripper = "hand"
FEWER = 104  # rollouts of a row that no claim of 200 rests on


@dataclass(frozen=True)
class Row:
    """One row of a table: which policy acts, and which sensors its finger wears.

    Of several sensors each is worn in an equal part of the scenes, one part after the other.
    """

    name: str
    policy: str = "latent/seed*"  # checkpoints, a pattern below the folder of all; they take turns
    worn: tuple[str, ...] = ("tactip",)  # in words (uniforce_vtla.contact.worn_in_words)
    fit: Fit = ""  # how each of them is calibrated; GelSight 1 and TacTip 1 need none
    left: tuple[str, ...] = ()  # units that the left finger wears meanwhile; () = GelSight 1
    # as ``uniforce score control=``
    control: Literal["", "frozen", "left_masked", "right_masked"] = ""
    rollouts: int = 204


def _both_exchanged(kind: str) -> Row:
    """Return the row in which both fingers wear units of another kind, each calibrated."""
    right = units(kind)
    left = right[1:] + right[:1]
    return Row(f"S2 both {kind}", worn=right, fit="grasps", left=left, rollouts=FEWER)


def _arms() -> list[Row]:
    """Return the paper's arms that aren't a rung: V is vision alone, V+T+G is S0."""
    uskins = units("uskin")
    tactips = ("tactip",) * len(uskins)
    return [
        Row("V+T", control="left_masked", rollouts=FEWER),
        Row("V+G", control="right_masked", rollouts=FEWER),
        Row("V+U", worn=uskins, fit="grasps", control="left_masked", rollouts=FEWER),
        Row("V+T+U", worn=tactips, fit="grasps", left=uskins, rollouts=FEWER),
    ]


def _ladder() -> tuple[Row, ...]:
    rows = [Row("S0")]
    for rung, kind in (("S1", "tactip"), ("S2 uskin", "uskin"), ("S2 gelsight", "gelsight")):
        rows.append(Row(rung, worn=(f"{kind}:any",)))
        rows.append(Row(f"{rung} by grasps", worn=units(kind), fit="grasps"))
        rows.append(Row(f"{rung} weighed", worn=units(kind), fit="tool"))
    rows.append(Row("frozen touch", control="frozen"))
    rows.append(Row("vision alone", "none/seed*"))
    rows.append(Row("true wrench", "wrench/seed*", rollouts=FEWER))
    rows.append(_both_exchanged("uskin"))
    rows.append(_both_exchanged("gelsight"))
    return (*rows, *_arms())


LADDER = _ladder()

CLAIMS = (
    AtMostWorse("another unit, calibrated by grasps", "S1 by grasps", "S0", 0.07),
    AtMostWorse("another unit, weighed", "S1 weighed", "S0", 0.04),
    AtMostWorse("another kind, calibrated by grasps", "S2 uskin by grasps", "S0", 0.12),
    AtMostWorse("another kind, calibrated by grasps", "S2 gelsight by grasps", "S0", 0.12),
    AtMostWorse("another kind, weighed", "S2 uskin weighed", "S0", 0.08),
    AtMostWorse("another kind, weighed", "S2 gelsight weighed", "S0", 0.08),
    AtMostWorse("next to the true wrench", "S0", "true wrench", 0.08),
    AtMostWorse("a second sensor", "S0", "V+T", 0.05),
    AtMostWorse("a second sensor", "V+T+U", "V+T", 0.05),
)
SLACK = 0.05  # of the bound beyond a claim's margin
BETTER = (
    ("S0", "frozen touch"),
    ("S0", "vision alone"),
    ("S2 uskin by grasps", "S2 uskin"),
    ("S2 gelsight by grasps", "S2 gelsight"),
)
