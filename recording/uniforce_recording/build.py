"""From a command line to devices: ``robot.KEY=…`` and ``teleop.KEY=…`` as LeRobot spells them, or a file."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import draccus
from lerobot.robots import RobotConfig
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig, make_teleoperator_from_config

from lerobot_robot_uniforce_franka import UniforceFranka, UniforceFrankaConfig
from uniforce_vtla.errors import ContractError, expected

OUR_TELEOPERATORS = "lerobot_teleoperator_uniforce"
ROBOTS = {"franka": "uniforce_franka"}


@dataclass
class Devices:
    """What LeRobot's commands hold, and a file of theirs can be read into."""

    robot: RobotConfig | None = None
    teleop: TeleoperatorConfig | None = None


def read_devices(flags: Sequence[str], robot: str, teleop: str, file: str = "") -> Devices:
    """Return the configs.

    Args:
        flags: ``--robot.KEY=…`` and ``--teleop.KEY=…``.
        robot: ``franka``, or "" for none.
        teleop: a name from ``teleoperator_names``.
        file: of LeRobot's form, with ``robot`` and ``teleop``; flags override it.

    Raises:
        ContractError: an unknown name, a file that isn't there, flags nobody knows.
    """
    names = teleoperator_names()
    if teleop not in names:
        do = "Name one."
        raise ContractError(expected("teleop", " | ".join(["expert", *sorted(names)]), repr(teleop), do))
    if file and not Path(file).is_file():
        raise ContractError(expected("rig", "a config file", file, "Give the file of robot and teleop."))
    types = [f"--teleop.type={names[teleop]}"]
    if robot:
        types.append(f"--robot.type={ROBOTS[robot]}")
    try:
        return draccus.parse(Devices, config_path=file or None, args=[*types, *flags])
    except (draccus.utils.DecodingError, draccus.ParsingError, ValueError) as error:
        raise ContractError(
            expected("robot.… teleop.…", "settings they have", error, "See docs/franka.md.")
        ) from error


def teleoperator_names() -> dict[str, str]:
    """Return short name → registered name; ours (``keyboard`` → ``uniforce_keyboard``) come before LeRobot's."""
    if importlib.util.find_spec(OUR_TELEOPERATORS) is not None:
        importlib.import_module(OUR_TELEOPERATORS)
    known = list(TeleoperatorConfig.get_known_choices())
    return {name: name for name in known} | {
        n.removeprefix("uniforce_"): n for n in known if n.startswith("uniforce_")
    }


def make_teleoperator(config: TeleoperatorConfig) -> Teleoperator:
    """Return the teleoperator, not connected.

    Raises:
        ContractError: LeRobot can't build it.
    """
    try:
        return make_teleoperator_from_config(config)
    except (ValueError, ImportError) as error:
        do = "Check its settings and what it needs installed."
        raise ContractError(expected("teleop", "one that can be built", error, do)) from error


def make_robot(config: RobotConfig, teleop: Teleoperator) -> UniforceFranka:
    """Return the robot, not connected, with the stiffness the teleoperator needs while it steers, if it needs one."""
    franka = cast("UniforceFrankaConfig", config)
    gains = getattr(teleop, "wants_gains", None)
    if gains is not None:
        franka.gains = gains
    return UniforceFranka(franka)
