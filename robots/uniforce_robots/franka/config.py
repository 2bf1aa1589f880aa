"""Settings of robot ``uniforce_franka``; nested ones are set as ``--robot.guards.step_m=0.03``."""

from dataclasses import dataclass, field
from typing import Literal

from lerobot.cameras import CameraConfig
from lerobot.robots.config import RobotConfig

from uniforce_robots.franka.arm import ROLLOUT, Gains
from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.franka.limits import (
    HandSettings,
    StreamSettings,
    require_in_limits,
    require_kind,
)
from uniforce_robots.sensors.config_uniforce import TactileFingerConfig
from uniforce_vtla.errors import ContractError, expected, require_one_of

NESTED = {"gains": Gains, "guards": GuardLimits, "stream": StreamSettings, "gripper": HandSettings}


@RobotConfig.register_subclass("uniforce_franka")
@dataclass(kw_only=True)
class UniforceFrankaConfig(RobotConfig):
    """A Franka Research 3 with its hand; hard limits of every number in ``limits.HARD_LIMITS``."""

    # of the robot's controller, its default; 127.0.0.N for the stand-in
    address: str = "172.16.0.2"
    backend: Literal["franky"] = "franky"  # the only client; kept, since rig files name it
    fps: float = 30.0  # actions per second; a target is reached within one period
    # stiffness and clip; the force bound is their product
    gains: Gains = field(default_factory=lambda: ROLLOUT)
    guards: GuardLimits = field(default_factory=GuardLimits)  # limits every action passes
    # rhythm and watchdog; its ``action_period_s`` follows ``fps``
    stream: StreamSettings = field(default_factory=StreamSettings)
    gripper: HandSettings = field(default_factory=HandSettings)  # how widths become commands
    # The robot's own stop, at any joint and along any axis. 40 N lies above the press of
    # 800 N/m × 18 mm and below what breaks a gel.
    reflex_torque_Nm: float = 40.0
    reflex_force_N: float = 40.0
    # for an answer, once the client is loaded; with its start a person waits 3 s
    connect_deadline_s: float = 2.5
    realtime: Literal["ignore", "enforce"] = "ignore"  # enforce needs PREEMPT_RT
    # payload beside the hand, as set in Desk; another one at connect is refused
    load_kg: float = 0.0
    # by name; each is one image of the observation. A tactile one has ``NAME_ref`` too, in free air
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    # fingers so far apart count as open, as a free-air reference needs; 0.08 is the widest
    open_width_m: float = 0.06
    # the right finger's newtons behind the axes, no marker images: for any LeRobot policy
    touch_in_state: bool = False
    right_calibration: str = ""  # with touch_in_state: folder of `uniforce calibrate`

    def __post_init__(self) -> None:
        super().__post_init__()
        require_in_limits(self)
        for name, kind in NESTED.items():
            require_kind(f"UniforceFrankaConfig.{name}", getattr(self, name), kind)
        require_one_of("backend", self.backend, ("franky",))
        require_one_of("realtime", self.realtime, ("ignore", "enforce"))
        if self.right_calibration and not self.touch_in_state:
            do = "Set touch_in_state=true, or give it to the policy."
            came = self.right_calibration
            raise ContractError(
                expected("right_calibration of the robot", "touch_in_state", came, do)
            )

    @property
    def right_finger(self) -> str | None:
        """Name of the right finger's camera; None without one."""
        for name, finger in self.fingers.items():
            if finger.finger == "right":
                return name
        return None

    @property
    def fingers(self) -> dict[str, TactileFingerConfig]:
        """The tactile ones of the cameras."""
        return {name: c for name, c in self.cameras.items() if isinstance(c, TactileFingerConfig)}
