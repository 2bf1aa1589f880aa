"""Options of ``uniforce score``: the policy, the rig and the scenes. Its processes read them, too."""

import re
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Literal

from uniforce_cli.boundary import Gripper, Level, Worn
from uniforce_vtla import options
from uniforce_vtla.contracts import Finger

SCRIPTS = ("expert",)  # the scene's own, who regulates by both pads' true wrench
ArmName = Annotated[str, options.Pattern("a name", r"[^/\\]{1,100}", "V+T")]


@dataclass(frozen=True)
class Rig:
    """A scene's level and what the fingers wear there; "" is the usual sensor, no swap and no calibration."""

    level: str
    left_sensor: str = ""
    right_sensor: str = ""
    swap: str = ""
    left_calibration: str = ""
    right_calibration: str = ""
    monitor: str = "stop"
    gripper: str = "servo"
    grip: str = ""

    @property
    def mounted(self) -> dict[Finger, str]:
        """Finger → what it wears, in words; the usual rig where none is named."""
        return {"left": self.left_sensor or "gelsight", "right": self.right_sensor or "tactip"}

    @property
    def kinds(self) -> dict[Finger, str]:
        """Finger → kind of sensor, which a policy knows or doesn't."""
        from uniforce_vtla.contact.worn_in_words import wear

        return {finger: wear(words)(0).kind for finger, words in self.mounted.items()}

    @property
    def calibrations(self) -> dict[Finger, str]:
        """Finger → folder of the calibration it wears."""
        worn: dict[Finger, str] = {"left": self.left_calibration, "right": self.right_calibration}
        return {finger: folder for finger, folder in worn.items() if folder}


@dataclass
class ScoreConfig:
    """Roll a checkpoint out and score it from simulator truth.

    Example: uniforce score policy=outputs/train/checkpoints/last/pretrained_model swap=touch0:left
    """

    # checkpoint folders (several, e.g. training seeds, take turns scene by scene)
    policy: options.Policies = "shipped"
    arm: ArmName = ""  # name of this arm in the table; "" = V+T or the script, and what it wears
    level: Level = "touch"
    # "" = gelsight, and it must be what the policy knows. Naming a sensor allows it to differ from training: unit 1 of
    # it, or uskin:7 | uskin:any (another in every scene) | uskin:drawing (as drawn, no camera: fast); faults stand
    # behind it: tactip:1+flicker=0.2 (uniforce_vtla/contact/faults.py)
    left_sensor: Worn = ""
    right_sensor: Worn = ""  # of the right finger, in the same words; "" = tactip
    # of `uniforce calibrate`: what the left finger's sensor wears
    left_calibration: options.FolderPath = ""
    # of `uniforce calibrate`, for the right finger's sensor
    right_calibration: options.FolderPath = ""
    # stop: where a sensor gives what no healthy one of its kind does the episode is aborted | off: go on
    monitor: Literal["stop", "off"] = "stop"
    # read: as the finger reads it | held: once lifted, as the demonstrations read it | "": held where the calibration
    # can't read grip under a tool
    grip: Literal["", "read", "held"] = ""
    # servo: the level's own, which regulates grip finely | hand: one that holds by force, as the robot's does
    gripper: Gripper = "servo"
    swap: options.Slots = ""  # e.g. touch0:left — which finger fills which slot
    # touch taken away | another scene's touch of the same phase | frozen half a second into the wipe
    control: Literal["", "masked", "shuffled", "frozen"] = ""
    rollouts: options.Count = 20  # 20 for parity with the paper, ≥ 200 for claims
    # demos are recorded from seed 0 on: scored scenes are never trained on
    first_seed: options.Seed = 10_000
    workers: options.Workers = 2  # processes, one torch thread each
    videos: options.CountOrZero = 1  # episodes filmed, the first ones
    # seeds filmed besides; rolled out again where scored unfilmed
    film: options.Seeds = field(default_factory=list)
    resume: bool = True  # keep episodes already scored in `out`
    out: options.OutFolder = "outputs/score"  # rows, table, picture and videos go here

    def __post_init__(self) -> None:
        """Name the arm, after what differs from the usual rig: arms of one folder need different names."""
        fingers = [(finger, getattr(self, f"{finger}_sensor")) for finger in ("left", "right")]
        differs = [f"{finger} {words}" for finger, words in fingers if words]
        differs += [f"{finger} calibrated" for finger in self.rig.calibrations]
        usual = self.policy if self.policy in SCRIPTS else "V+T"
        differs += [f"grip {self.grip}"] if self.grip else []
        differs += ["hand"] if self.gripper == "hand" else []
        differs += ["unwatched"] if self.monitor == "off" else []
        self.arm = self.arm or ", ".join(
            [usual, *differs, *filter(None, (self.swap, self.control))]
        )

    @property
    def policies(self) -> list[str]:
        """Policies that take turns."""
        return options.split(self.policy) or [self.policy]

    def policy_of(self, seed: int) -> str:
        """Return which policy acts in the scene of that seed."""
        from uniforce_vtla.evaluation.arms import whose_turn

        return whose_turn(seed - self.first_seed, self.policies)

    @property
    def seeds(self) -> range:
        """Scenes that are scored."""
        return range(self.first_seed, self.first_seed + self.rollouts)

    @property
    def rig(self) -> Rig:
        """The scene's level and what the fingers wear."""
        return Rig(**{field.name: getattr(self, field.name) for field in fields(Rig)})

    @property
    def folder(self) -> Path:
        """Where this arm's rows, sheets and videos go."""
        swap = f"_{self.swap.replace(':', '-')}" if self.swap else ""
        swap += "".join(f"_{finger}-calibrated" for finger in self.rig.calibrations)
        arm = re.sub(r"\W+", "-", self.arm.replace("+", "")).strip("-")
        control = f"_{self.control}" if self.control else ""
        control += "_unwatched" if self.monitor == "off" else ""
        rig = "+".join(self.rig.mounted.values()).replace(":", "-").replace("=", "-")
        grip = f"_grip-{self.grip}" if self.grip else ""
        hand = "_hand" if self.gripper == "hand" else ""
        return Path(self.out) / f"{arm}_{rig}_{self.level}{hand}{grip}{swap}{control}"

    def video(self, seed: int) -> Path:
        """Return where an episode's video lies, once it is filmed."""
        return self.folder / f"seed_{seed}.mp4"
