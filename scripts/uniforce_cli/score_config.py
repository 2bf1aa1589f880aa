"""What to score: one arm of the wiping task."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from uniforce_cli.option_types import Level, Sensor
from uniforce_vtla.arguments import names_in
from uniforce_vtla.contracts import Finger
from uniforce_vtla.evaluation.arms import whose_turn
from uniforce_vtla.options import (
    Count,
    CountOrZero,
    OutFolder,
    Pattern,
    Policies,
    Seed,
    Seeds,
    Slots,
    Workers,
)

SCRIPTS = ("expert", "blind")  # the scene's own: one regulates by both pads' true wrench, one uses no touch
ArmName = Annotated[str, Pattern("a name", r"[^/\\]{1,100}", "V+T")]


@dataclass
class ScoreConfig:
    """Roll a checkpoint out and score it from simulator truth.

    Example: uniforce score policy=outputs/train/checkpoints/last/pretrained_model swap=touch0:left
    """

    # checkpoint folder; shipped = the tiny V+T policy in the package; or expert | blind. Several (comma between them,
    # e.g. two training seeds) take turns, scene by scene
    policy: Policies = "shipped"
    arm: ArmName = ""  # name of this arm in the table; "" = V+T, or the script's own
    level: Level = "paper"  # easy | paper (what the shipped policy learnt at) | touch | hard
    left_sensor: Sensor = ""  # gelsight | tactip | uskin; "" = gelsight, and it must be what the policy knows
    right_sensor: Sensor = ""  # likewise; "" = tactip. Naming a sensor allows it to differ from training
    swap: Slots = ""  # e.g. touch0:left — which finger fills which slot
    # masked = touch taken away, shuffled = another scene's touch of the same phase
    control: Literal["", "masked", "shuffled"] = ""
    rollouts: Count = 20  # 20 for parity with the paper, ≥ 200 for claims
    first_seed: Seed = 10_000  # demos are recorded from seed 0 on: scored scenes are never trained on
    workers: Workers = 2  # processes, one torch thread each
    videos: CountOrZero = 1  # episodes filmed, the first ones
    film: Seeds = field(default_factory=list)  # seeds filmed besides; rolled out again where scored unfilmed
    resume: bool = True  # keep episodes already scored in `out`
    out: OutFolder = "outputs/score"  # rows, table, picture and videos go here

    def __post_init__(self) -> None:
        """Name the arm."""
        self.arm = self.arm or (self.policy if self.policy in SCRIPTS else "V+T")

    @property
    def policies(self) -> list[str]:
        """Who takes turns."""
        return names_in(self.policy) or [self.policy]

    def policy_of(self, seed: int) -> str:
        """Return which policy acts in the scene of that seed."""
        return whose_turn(seed - self.first_seed, self.policies)


def mounted_sensors(left: str = "", right: str = "") -> dict[Finger, str]:
    """Finger → sensor of the scene scored; the usual rig where none is named."""
    return {"left": left or "gelsight", "right": right or "tactip"}
