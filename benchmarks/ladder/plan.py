"""Plan of the ladder: rows, scenes and claims. Fixed before a policy of it is trained.

The demonstrations wear one unit per finger: TacTip 1 right, GelSight 1 left in one half and uSkin 1
in the other. The ladder exchanges the sensor of the finger that the policy feels with, the right
one. Exchanging the finger is another question: eraser and board load the two unlike, and with its
true wrench the other finger is 20 points worse (development scenes, 24 each: 21 clean with the same
finger, 16 with the other). The paper's arms ask it.

V+T is the default of ``size=tiny``: the right finger's three newtons, read in the latent by a
frozen head. Checkpoints are folders of training seeds, ``<checkpoints>/<arm>/seed0`` …; all arms
learn from the same demonstrations with the same recipe. Settings were chosen on development scenes,
with V+T on rungs S0 and S1 alone. GelSight and uSkin were looked at there too, to find out why the
exchange failed; final scenes were not.

"Within X points" is a paired estimate of at most X and a one-sided 95 % bound of at most X + 5.
"Buys" is a paired interval clear of 0 and the same sign in every training seed.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from uniforce_vtla.contracts import Finger
from uniforce_vtla.evaluation.comparison import AtMostWorse, CleanBySeed, as_good

SWAP = "touch0:left"


@dataclass(frozen=True)
class Entry:
    """One row of the table: which checkpoints act, on which rig.

    Of several sensors in the slot each is worn in an equal part of the scenes, one part after the
    other.
    """

    name: str
    checkpoints: str  # arm that was trained, or "expert"
    worn: tuple[str, ...] = ("tactip",)  # in words (uniforce_vtla.contact.worn)
    finger: Finger = "right"  # which wears it; the other one wears what the demonstrations had
    swap: str = ""
    calibrated: bool = False  # each wears its calibration against the demonstrations' TacTip
    tokenizer: str = "shipped"  # whose latents the checkpoints read: folder of the calibrations
    control: str = ""
    grip: str = ""  # as ``ScoreConfig.grip``
    block: str = "swap ladder"  # of scenes (benchmarks.scene_blocks)
    rollouts: int = 204  # parts of 51: the same training seed acts in a scene in every row


UNITS = (2, 3, 4, 5)  # those that are calibrated: the first ones that no demonstration wore


def _units(kind: str) -> tuple[str, ...]:
    return tuple(f"{kind}:{unit}" for unit in UNITS)


def _halves(weak: str, strong: str) -> tuple[str, ...]:
    """Two units each of a sensor that answers by about × .6 and of one by × 1.4 to 1.5."""
    return *_units(weak)[:2], *_units(strong)[2:]


ODD_GELSIGHT, ODD_USKIN = (
    _halves("gelsight_stiff", "gelsight_soft"),
    _halves("uskin_dull", "uskin_keen"),
)
LADDER = (
    Entry("S0", "vt"),
    Entry("S1", "vt", ("tactip:any",)),
    Entry("S1 calibrated", "vt", _units("tactip"), calibrated=True),
    Entry("S2 gelsight", "vt", ("gelsight:any",)),
    Entry("S2 uskin", "vt", ("uskin:any",)),
    Entry("S2 gelsight calibrated", "vt", _units("gelsight"), calibrated=True),
    Entry("S2 uskin calibrated", "vt", _units("uskin"), calibrated=True),
    Entry("S4 gelsight", "vt", ODD_GELSIGHT),
    Entry("S4 uskin", "vt", ODD_USKIN),
    Entry("S4 gelsight calibrated", "vt", ODD_GELSIGHT, calibrated=True),
    Entry("S4 uskin calibrated", "vt", ODD_USKIN, calibrated=True),
)


def _without(kind: str) -> tuple[Entry, ...]:
    """Return the rows that ask what a kind of sensor, left out of the training, costs."""
    worn = _units(kind)
    arm = f"vt_no_{kind}"
    left_out: dict[str, Any] = {"tokenizer": f"no_{kind}", "block": "kinds left out"}
    reduced = left_out | {"tokenizer": "all"}
    return (
        Entry(f"S2 {kind} calibrated reduced", "vt_all", worn, calibrated=True, **reduced),
        Entry(f"S0 without {kind}", arm, **left_out),
        Entry(f"S3 {kind}", arm, worn, **left_out),
        Entry(f"S3 {kind} calibrated", arm, worn, calibrated=True, **left_out),
    )


# tokenizers of one reduced budget (preset=nano): all kinds, no uSkin, no flat gel at all; policies
# learn anew from whole latents of each: only a packaged tokenizer has a head that reads newtons
LEFT_OUT = (
    Entry("S0 reduced", "vt_all", tokenizer="all", block="kinds left out"),
    *_without("gelsight"),
    *_without("uskin"),
)
# the same question of newtons, planned on 2026-11-27 after the answer for whole latents: a head
# fitted to simulated TacTips reads force in the latents of the tokenizer that never saw a uSkin,
# nor did the head
LEFT_OUT_IN_NEWTONS = tuple(
    Entry(name, "vt_no_uskin_newtons", worn, calibrated=calibrated, tokenizer="no_uskin",
          block="kinds left out, felt in newtons", rollouts=68)
    for name, worn, calibrated in (
        ("S0 newtons without uskin", ("tactip",), False),
        ("S3 uskin newtons", _units("uskin"), False),
        ("S3 uskin newtons calibrated", _units("uskin"), True),
    )
)  # fmt: skip
# units whose scale was fitted to three known loads (`uniforce calibrate new=tactip:2
# loads_N=3,6,9`), planned on 2026-11-28 before a scene of it was rolled out; their gains lie in the
# calibrations' folder "weighed". The last row was added on the same day, before the result of any
# of them was seen: gains relative to TacTip 1, whose readings the policies learnt as they are
# (`relative_to=` of commit 3459784f; it bought nothing and left)
WEIGHED = tuple(
    Entry(
        name,
        "vt",
        worn,
        calibrated=gains != "",
        tokenizer=gains or "shipped",
        block="units weighed",
        rollouts=96,
    )
    for name, worn, gains in (
        ("S0 beside weighed", ("tactip",), ""),
        ("S1 beside weighed", _units("tactip"), ""),
        ("S1 weighed", _units("tactip"), "weighed"),
        ("S1 weighed beside TacTip 1", _units("tactip"), "weighed_beside"),
    )
)
# the same swap for other things to feel with, each with the same alignment
RUNGS = ("S0", "S2 gelsight calibrated", "S2 uskin calibrated")
# raw images get none: a linear map of two pictures is none of a sensor's. The random encoder has
# the shipped one's size and never learnt; its policy gets three newtons too, by a head fitted to
# its latents of simulated TacTips (planned on 2026-11-27, before that policy was trained: one
# training seed, 34 rollouts a sensor worn)
CONTROLS = tuple(
    Entry(f"{what} {rung}", arm, worn, calibrated=calibrated and maps != "", tokenizer=maps,
          block="controls", rollouts=102)
    for what, arm, maps in (
        ("three newtons", "vt", "shipped"),
        ("whole latents", "latents", "shipped"),
        ("descriptor", "descriptor", "descriptor"),
        ("raw images", "marker_pair", ""),
        ("random encoder", "random", "random"),
    )
    for rung, worn, calibrated in (
        (RUNGS[0], ("tactip",), False),
        (RUNGS[1], _units("gelsight")[:2], True),
        (RUNGS[2], _units("uskin")[:2], True),
    )
)  # fmt: skip
ARMS = (
    Entry("expert", "expert", block="arms"),
    Entry("true wrench", "wrench", block="arms"),
    Entry("V+T", "vt", block="arms"),
    Entry("V", "v", block="arms"),
    Entry("V with history", "v_history", block="arms"),
    # the paper's arms: another sensor on the other finger, which bears another part of the press.
    # The true wrench of that finger says how much of a loss is the finger's
    Entry("V+G", "vt", ("gelsight",), "left", SWAP, block="arms"),
    Entry("V+U", "vt", ("uskin",), "left", SWAP, block="arms"),
    Entry("true wrench of the other finger", "wrench", ("gelsight",), "left", SWAP, block="arms"),
    # one policy that feels with both fingers; it learnt from both halves of the demonstrations
    Entry("V+T+G", "two_fingers", ("gelsight",), "left", block="arms"),
    Entry("V+T+U", "two_fingers", ("uskin",), "left", block="arms"),
    Entry("V+T masked", "vt", control="masked", block="arms", rollouts=102),
    Entry("V+T shuffled", "vt", control="shuffled", block="arms", rollouts=102),
    Entry("V+T frozen", "vt", control="frozen", block="arms"),
)
# Does holding a grip that a flat gel can't read buy anything? Planned on 2026-11-28, before a scene
# was rolled out: the shipped policy, GelSights 2 to 5 with the label-free map of 300 grasps each,
# the level's servo, 100 development scenes that nothing was chosen on. Gate: held is at least 25
# points above read, exact McNemar p < .01
GRIP = (
    Entry("S0 beside grip", "shipped", block="grip held", rollouts=24),
    *(
        Entry(
            name,
            "shipped",
            _units("gelsight"),
            calibrated=True,
            grip=grip,
            block="grip held",
            rollouts=100,
        )
        for name, grip in (
            ("S2 gelsight calibrated, grip read", "read"),
            ("S2 gelsight calibrated, grip held", ""),
        )
    ),
)
PARTS = {
    "grip": GRIP,
    "ladder": LADDER,
    "left_out": LEFT_OUT + LEFT_OUT_IN_NEWTONS,
    "weighed": WEIGHED,
    "controls": CONTROLS,
    "arms": ARMS,
}

CLAIMS = (
    AtMostWorse("another unit", "S1", "S0", 0.07),
    AtMostWorse("another unit, weighed", "S1 weighed", "S0 beside weighed", 0.07),
    AtMostWorse("another unit, weighed", "S1 weighed beside TacTip 1", "S0 beside weighed", 0.07),
    AtMostWorse("another kind", "S2 gelsight", "S0", 0.12),
    AtMostWorse("another kind", "S2 uskin", "S0", 0.12),
    AtMostWorse("stiffer or keener, calibrated", "S4 uskin calibrated", "S0", 0.15),
    AtMostWorse("stiffer or keener, calibrated", "S4 gelsight calibrated", "S0", 0.15),
    AtMostWorse(
        "a kind left out of everything, calibrated", "S3 gelsight calibrated", "S0 reduced", 0.15
    ),
    AtMostWorse(
        "a kind left out of everything, calibrated", "S3 uskin calibrated", "S0 reduced", 0.15
    ),
    AtMostWorse(
        "a kind left out of everything, calibrated",
        "S3 uskin newtons calibrated",
        "S0 newtons without uskin",
        0.15,
    ),
    AtMostWorse("next to the true wrench", "V+T", "true wrench", 0.08),
    AtMostWorse("next to the true wrench", "V+T+G", "true wrench", 0.08),
    AtMostWorse("next to the true wrench", "V+T+U", "true wrench", 0.08),
)
SLACK = 0.05  # of the bound beyond a claim's margin
BETTER = (
    ("S2 gelsight calibrated, grip held", "S2 gelsight calibrated, grip read"),
    ("S1 weighed", "S1 beside weighed"),
    ("S1 weighed beside TacTip 1", "S1 beside weighed"),
    ("V+T", "V"),
    ("V+T", "V with history"),
    ("V+T", "V+T frozen"),
    ("V+T", "V+T masked"),
    ("V+T", "V+T shuffled"),
    ("V+T", "best blind"),
    *(
        (f"three newtons {rung}", f"{what} {rung}")
        for rung in RUNGS
        for what in ("whole latents", "descriptor", "raw images", "random encoder")
    ),
    ("S0 without uskin", "S3 uskin calibrated"),
    ("S2 uskin calibrated reduced", "S3 uskin calibrated"),
    ("S0 reduced", "S2 uskin calibrated reduced"),
)


def claims(arms: Mapping[str, CleanBySeed]) -> list[dict[str, Any]]:
    """Return the plan's claims with their verdict: estimate in the margin, bound in the slack."""
    found = as_good(arms, CLAIMS)
    for claim in found:
        within = (
            claim["difference"] >= -claim["margin"] and claim["lower"] >= -claim["margin"] - SLACK
        )
        claim["holds"] = bool(within)
    return found
