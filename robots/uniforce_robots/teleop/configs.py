"""Settings of every teleoperator; LeRobot finds the class ``X`` in this package by the name ``XConfig``.

Nested ones are set as ``--teleop.limits.speed=[0.05,0.05,0.05,0.3,0.06]``. They stand first in a docstring:
LeRobot's parser reads on from their line, and breaks where the closing quotes come next.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from lerobot.teleoperators import TeleoperatorConfig

from uniforce_robots.fr3 import HAND_TO_FLANGE
from uniforce_robots.teleop.integrator import StartWindow, TargetLimits


@TeleoperatorConfig.register_subclass("uniforce_keyboard")
@dataclass(kw_only=True)
class UniforceKeyboardConfig(TeleoperatorConfig):
    """Keys of a terminal."""

    limits: TargetLimits = field(default_factory=TargetLimits)


@TeleoperatorConfig.register_subclass("uniforce_hand_guide")
@dataclass(kw_only=True)
class UniforceHandGuideConfig(TeleoperatorConfig):
    """A person leads the soft arm; the limits hold for the width alone."""

    limits: TargetLimits = field(default_factory=TargetLimits)


@TeleoperatorConfig.register_subclass("uniforce_spacemouse")
@dataclass(kw_only=True)
class UniforceSpaceMouseConfig(TeleoperatorConfig):
    """A 3Dconnexion SpaceMouse.

    Attributes:
        limits: speeds at full deflection.
        device: e.g. /dev/hidraw3, or the path of a local packet socket; empty looks for the only one plugged in.
        deadband: share of full deflection that is rest; a cap never comes back to zero exactly.
        signs: of right, forward, up and counter-clockwise in the device's own counts.
        operator_yaw_rad: which way "forward" is in the base frame; 0: the operator looks along +x.
    """

    limits: TargetLimits = field(default_factory=TargetLimits)
    device: str = ""
    deadband: float = 0.08
    signs: tuple[int, int, int, int] = (1, -1, -1, -1)
    operator_yaw_rad: float = 0.0


@TeleoperatorConfig.register_subclass("uniforce_gello")
@dataclass(kw_only=True)
class UniforceGelloConfig(TeleoperatorConfig):
    """A GELLO: a small arm of Dynamixel motors with the Franka's proportions.

    Attributes:
        limits: how fast the target follows.
        start: how far it may stand from the robot.
        port: serial port, e.g. /dev/serial/by-id/usb-FTDI_….
        baud: of the motors.
        ids: seven joints and the gripper's trigger.
        signs, offsets_rad: joint = sign × (motor − offset); ``gello.offsets`` finds the offsets of a held posture.
        trigger_rad: motor angle of the trigger when open and when pulled.
        width_m: of the fingers when open and when pulled.
        flange_to_tool_m: the point between the finger tips; the Franka Hand's own by default.
    """

    limits: TargetLimits = field(default_factory=lambda: TargetLimits(speed=(0.2, 0.2, 0.2, 1.2, 0.1)))
    start: StartWindow = field(default_factory=StartWindow)
    port: str = ""
    baud: int = 57_600  # as the motors come; GELLO builds often set 1_000_000
    ids: tuple[int, ...] = (1, 2, 3, 4, 5, 6, 7, 8)
    signs: tuple[int, ...] = (1, 1, 1, 1, 1, 1, 1)
    offsets_rad: tuple[float, ...] = (0.0,) * 7
    trigger_rad: tuple[float, float] = (0.0, 0.7)
    width_m: tuple[float, float] = (0.08, 0.0)
    flange_to_tool_m: float = float(HAND_TO_FLANGE[2, 3])


@TeleoperatorConfig.register_subclass("uniforce_gamepad")
@dataclass(kw_only=True)
class UniforceGamepadConfig(TeleoperatorConfig):
    """LeRobot's own gamepad; three axes and the fingers, no turn; the limits are speeds at full deflection."""

    limits: TargetLimits = field(default_factory=TargetLimits)


@TeleoperatorConfig.register_subclass("uniforce_phone")
@dataclass(kw_only=True)
class UniforcePhoneConfig(TeleoperatorConfig):
    """LeRobot's own phone: its pose moves the target while its button is held.

    Attributes:
        limits: how fast the target follows.
        phone_os: ios (HEBI Mobile I/O) or android (WebXR page).
        silent_s: without a pose, or with the very same one, for so long it is lost.
    """

    limits: TargetLimits = field(default_factory=lambda: TargetLimits(speed=(0.2, 0.2, 0.2, 1.2, 0.06)))
    phone_os: Literal["ios", "android"] = "ios"
    silent_s: float = 0.5


@TeleoperatorConfig.register_subclass("uniforce_expert")
@dataclass(kw_only=True)
class UniforceExpertConfig(TeleoperatorConfig):
    """The scripted expert of the simulated scene; of no use to a real robot.

    Attributes:
        fingers: which pads it reads: both, left, right or none.
    """

    fingers: Literal["both", "left", "right", "none"] = "both"


@TeleoperatorConfig.register_subclass("uniforce_replay")
@dataclass(kw_only=True)
class UniforceReplayConfig(TeleoperatorConfig):
    """Actions from a file, row by row.

    Attributes:
        path: .npz, .csv, or a .parquet of a LeRobot dataset.
        episode: of a file that holds several; None takes a file that holds one.
        start: how far the first row may lie from the robot.
        jump: largest change of an axis from one row to the next, x, y, z m, yaw rad, width m.
    """

    path: str = ""
    episode: int | None = None
    start: StartWindow = field(default_factory=lambda: StartWindow(0.02, 0.1, 0.02))
    jump: tuple[float, ...] = (
        0.02,
        0.02,
        0.02,
        0.15,
        0.02,
    )  # at 30 Hz more than twice what the guards let through
