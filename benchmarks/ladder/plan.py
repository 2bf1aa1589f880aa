"""What is scored, on which scenes, and what is claimed of it. Fixed before a policy of it is trained.

The demonstrations wear one unit per finger, GelSight 1 left and TacTip 1 right. Checkpoints are folders of training
seeds, ``<checkpoints>/<arm>/seed0`` …; all arms learn from the same demonstrations with the same recipe.
Settings were chosen on development scenes, with V+T on rungs S0 and S1 alone.

"Within X points" is a paired estimate of at most X and a one-sided 95 % bound of at most X + 5. "Buys" is a paired
interval clear of 0 and the same sign in every training seed.
"""

from dataclasses import dataclass

from uniforce_vtla.evaluation.comparison import AtMostWorse

SWAP = "touch0:left"


@dataclass(frozen=True)
class Entry:
    """One row of the table: which checkpoints act, on which rig."""

    name: str
    checkpoints: str  # arm that was trained, or "expert"
    left: str = "gelsight"  # what the left finger wears (uniforce_vtla.contact.worn)
    right: str = "tactip"
    swap: str = ""
    calibrated: bool = False  # the swapped finger wears a calibration against a TacTip
    control: str = ""
    block: str = "swap ladder"  # of scenes (benchmarks.scene_blocks)
    rollouts: int = 200

    @property
    def worn(self) -> str:
        """Name of the sensor that fills the slot."""
        return (self.left if self.swap else self.right).partition(":")[0]


LADDER = (
    Entry("S0", "vt"),
    Entry("S1", "vt", right="tactip:any"),
    Entry("S2 gelsight", "vt", swap=SWAP),
    Entry("S2 uskin", "vt", left="uskin", swap=SWAP),
    Entry("S2 gelsight calibrated", "vt", swap=SWAP, calibrated=True),
    Entry("S2 uskin calibrated", "vt", left="uskin", swap=SWAP, calibrated=True),
    Entry("S4 uskin", "vt", left="uskin_keen", swap=SWAP),
    Entry("S4 uskin calibrated", "vt", left="uskin_keen", swap=SWAP, calibrated=True),
    Entry("S4 gelsight", "vt", left="gelsight_stiff", swap=SWAP),
    Entry("S4 gelsight calibrated", "vt", left="gelsight_stiff", swap=SWAP, calibrated=True),
)
# the same swap for other things to feel with, each with the same alignment
CONTROLS = tuple(
    Entry(f"{what} {rung}", arm, left=left, swap=swap, calibrated=calibrated, block="controls", rollouts=100)
    for what, arm in (
        ("three newtons", "newtons"),
        ("descriptor", "descriptor"),
        ("raw images", "marker_pair"),
        ("random encoder", "random"),
    )
    for rung, left, swap, calibrated in (
        ("S0", "gelsight", "", False),
        ("S2 gelsight", "gelsight", SWAP, True),
        ("S2 uskin", "uskin", SWAP, True),
    )
)
ARMS = (
    Entry("expert", "expert", block="arms"),
    Entry("true wrench", "wrench", block="arms"),
    Entry("V+T", "vt", block="arms"),
    Entry("V", "v", block="arms"),
    Entry("V with previous action", "v_history", block="arms"),
    Entry("V+T masked", "vt", control="masked", block="arms", rollouts=100),
    Entry("V+T shuffled", "vt", control="shuffled", block="arms", rollouts=100),
    Entry("V+T frozen mid-wipe", "vt", control="frozen", block="arms", rollouts=100),
)
PARTS = {"ladder": LADDER, "controls": CONTROLS, "arms": ARMS}

CLAIMS = (
    AtMostWorse("another unit", "S1", "S0", 0.07),
    AtMostWorse("another kind", "S2 gelsight", "S0", 0.12),
    AtMostWorse("another kind", "S2 uskin", "S0", 0.12),
    AtMostWorse("stiffer or keener, calibrated", "S4 uskin calibrated", "S0", 0.15),
    AtMostWorse("stiffer or keener, calibrated", "S4 gelsight calibrated", "S0", 0.15),
    AtMostWorse("next to the true wrench", "V+T", "true wrench", 0.08),
)
SLACK = 0.05  # of the bound beyond a claim's margin
BETTER = (("V+T", "V"), ("V+T", "V with previous action"), ("V+T", "V+T frozen mid-wipe"), ("V+T", "V+T masked"))
