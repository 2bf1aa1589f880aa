"""Options of ``uniforce score`` and its processes: the policy, the rig and the scenes."""

import re
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Literal

from uniforce_cli.boundary import Gripper, Level, Worn
from uniforce_vtla import options
from uniforce_vtla.contracts import Finger

SCRIPTS = ("expert",)  # the scripted expert; uses the true wrench of both pads
ArmName = Annotated[str, options.Pattern("a name", r"[^/\\]{1,100}", "uSkin")]


def checkpoint_of(policy: str) -> Path:
    """Return a checkpoint's folder; "shipped" is the package's own."""
    from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint

    return shipped_checkpoint() if policy == "shipped" else Path(policy)


@dataclass(frozen=True)
class Rig:
    """A scene's level and the fingers' sensors; "" is the usual sensor, no swap, no calibration."""

    level: str
    left_sensor: str = ""
    right_sensor: str = ""
    swap: str = ""
    left_calibration: str = ""
    right_calibration: str = ""
    monitor: str = "stop"
    gripper: str = "hand"

    @property
    def mounted(self) -> dict[Finger, str]:
        """Finger → its sensor, in words; the usual one where none is named."""
        return {"left": self.left_sensor or "gelsight", "right": self.right_sensor or "tactip"}

    @property
    def kinds(self) -> dict[Finger, str]:
        """Finger → kind of sensor, which a policy knows or doesn't."""
        from uniforce_vtla.contact.worn_in_words import wear

        return {finger: wear(words)(0).kind for finger, words in self.mounted.items()}

    @property
    def calibrations(self) -> dict[Finger, str]:
        """Finger → folder of the calibration of its sensor."""
        found: dict[Finger, str] = {}
        if self.left_calibration:
            found["left"] = self.left_calibration
        if self.right_calibration:
            found["right"] = self.right_calibration
        return found


@dataclass
class ScoreConfig:
    """Roll a checkpoint out and score it from simulator truth.

    Example: uniforce score policy=outputs/train/checkpoints/last/pretrained_model swap=touch0:left
    """

    # checkpoint folders; several, e.g. of training seeds, take turns scene by scene
    policy: options.Policies = "shipped"
    # name of this arm in the table; "" = the policy or script, and how the rig differs from the
    # usual one
    arm: ArmName = ""
    level: Level = "touch"  # level of the scene
    # sensor on the left finger; "" = gelsight, if the policy was trained with it. A named sensor
    # may differ from training: uskin = unit 1 | uskin:7 = unit 7 | uskin:any = another unit in
    # every scene | uskin:drawing = as drawn, no camera, fast. Faults stand behind it:
    # tactip:1+flicker=0.2 (uniforce_vtla/contact/faults.py)
    left_sensor: Worn = ""
    # sensor on the right finger; "" = tactip, if the policy was trained with it. A named sensor may
    # differ from training: uskin = unit 1 | uskin:7 = unit 7 | uskin:any = another unit in every
    # scene | uskin:drawing = as drawn, no camera, fast. Faults stand behind it:
    # tactip:1+flicker=0.2 (uniforce_vtla/contact/faults.py)
    right_sensor: Worn = ""
    # folder that uniforce calibrate wrote for the left finger's sensor; "" = none
    left_calibration: options.FolderPath = ""
    # folder that uniforce calibrate wrote for the right finger's sensor; "" = none
    right_calibration: options.FolderPath = ""
    # stop = abort the episode when a sensor looks unhealthy | off = go on
    monitor: Literal["stop", "off"] = "stop"
    # hand = holds by force, as the robot's hand does | servo = follows every tenth of a
    # millimetre, as no hand does
    gripper: Gripper = "hand"
    swap: options.Slots = ""  # which finger fills which touch slot, e.g. touch0:left
    # masked = touch is taken away | left_masked, right_masked = that of one finger | frozen = touch
    # stays as it was half a second into the wipe | "" = touch as it is
    control: Literal["", "masked", "left_masked", "right_masked", "frozen"] = ""
    rollouts: options.Count = 20  # scenes to score; 20 as in the paper, ≥ 200 for claims
    # seed of the first scene; demos are recorded from seed 0 on, so these scenes weren't trained on
    first_seed: options.Seed = 10_000
    workers: options.Workers = 2  # processes, one torch thread each
    # how many of the first episodes are filmed while they are scored, not those already scored
    videos: options.CountOrZero = 1
    # seeds of further episodes to film; one that was scored unfilmed is rolled out again
    film: options.Seeds = field(default_factory=list)
    resume: bool = True  # keep episodes already scored in `out`
    out: options.OutFolder = "outputs/score"  # folder for rows, table, picture and videos

    def __post_init__(self) -> None:
        """Name the arm after its differences from the usual rig, so that arms' names differ."""
        words = [self.policy if self.policy in SCRIPTS else "policy"]
        if self.left_sensor:
            words.append(f"left {self.left_sensor}")
        if self.right_sensor:
            words.append(f"right {self.right_sensor}")
        words += [f"{finger} calibrated" for finger in self.rig.calibrations]
        if self.gripper == "servo":
            words.append("servo")
        if self.monitor == "off":
            words.append("unwatched")
        words += filter(None, (self.swap, self.control))
        self.arm = self.arm or ", ".join(words)

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
        """The scene's level and the fingers' sensors."""
        return Rig(**{field.name: getattr(self, field.name) for field in fields(Rig)})

    @property
    def folder(self) -> Path:
        """Where this arm's rows, sheets and videos go."""
        arm = re.sub(r"\W+", "-", self.arm.replace("+", "")).strip("-")
        sensors = re.sub("[:=]", "-", "+".join(self.rig.mounted.values()))
        words = [arm, sensors, self.level]
        if self.gripper == "servo":
            words.append("servo")
        if self.swap:
            words.append(self.swap.replace(":", "-"))
        words += [f"{finger}-calibrated" for finger in self.rig.calibrations]
        if self.control:
            words.append(self.control)
        if self.monitor == "off":
            words.append("unwatched")
        return Path(self.out) / "_".join(words)

    def video(self, seed: int) -> Path:
        """Return the path of an episode's video."""
        return self.folder / f"seed_{seed}.mp4"
