"""From a command line to devices: ``robot.KEY=…`` and ``teleop.KEY=…`` as LeRobot spells them, or a file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import draccus
import yaml
from lerobot.robots import RobotConfig
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig, make_teleoperator_from_config

import uniforce_robots.teleop  # noqa: F401  registers ours
from uniforce_datasets.rig_settings import plain_settings
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka.arm import ROLLOUT
from uniforce_vtla.arguments import Option, check, options_of, own_cause, read_value, refuse_unknown
from uniforce_vtla.errors import ContractError, expected, require_one_of
from uniforce_vtla.options import check_text

FRANKA = "uniforce_franka"


def read_devices(
    flags: Sequence[str], franka: bool, teleop: str, file: str = ""
) -> tuple[RobotConfig | None, TeleoperatorConfig]:
    """Return the configs of robot and teleoperator; no robot means the simulated scene.

    Args:
        flags: ``--robot.KEY=…`` and ``--teleop.KEY=…``; dots lead into nested settings, also into one camera's.
        franka: whether there is a robot.
        teleop: a name from ``teleoperator_names``.
        file: of LeRobot's form, with ``robot`` and ``teleop``; flags override it.

    Raises ContractError: an unknown name, a file that isn't there, unknown settings.
    """
    names = teleoperator_names()
    require_one_of("teleop", teleop, sorted(names), "Name one, or expert.")
    settings = _read_file(file) if file else {}
    settings.setdefault("teleop", {})["type"] = names[teleop]
    options = options_of(TeleoperatorConfig.get_choice_class(names[teleop]), "teleop.")
    if franka:
        settings.setdefault("robot", {})["type"] = FRANKA
        options |= options_of(RobotConfig.get_choice_class(FRANKA), "robot.")
    _with_flags(settings, flags, options)
    robot = _decode(RobotConfig, "robot", settings) if franka else None
    return robot, _decode(TeleoperatorConfig, "teleop", settings)


def _read_file(file: str) -> dict[str, Any]:
    if not Path(file).is_file():
        raise ContractError(expected("rig", "a config file", file, "Give the file of robot and teleop."))
    content = yaml.safe_load(Path(file).read_text())  # JSON is YAML
    if not isinstance(content, dict):
        raise ContractError(expected(file, "robot: {…} and teleop: {…}", type(content).__name__, "Look at it."))
    return content


def _with_flags(settings: dict[str, Any], flags: Sequence[str], options: Mapping[str, Option]) -> None:
    """Put flags into the settings, checked as far as their options say what they may be.

    Not through draccus' own parser, which stumbles over unrelated classes.
    """
    names = [flag.removeprefix("--").partition("=")[0] for flag in flags]
    refuse_unknown([name for name in names if not any(name.startswith(f"{o}.") for o in options)], options)
    for name, flag in zip(names, flags, strict=True):
        text = flag.partition("=")[2]
        check_text(name, text)
        *path, last = name.split(".")
        inner = settings
        for key in path:
            inner = inner.setdefault(key, {})
        inner[last] = read_value(options[name], text) if name in options else yaml.safe_load(text)
        if name in options:
            check(options[name], inner[last])


def _decode[ConfigT](config_class: type[ConfigT], part: str, settings: dict[str, Any]) -> ConfigT:
    try:
        decoded: ConfigT = draccus.decode(config_class, settings[part])
    except (draccus.utils.DecodingError, ValueError, TypeError) as error:
        came, do = own_cause(error) or error, "See docs/franka.md and docs/tactile_devices.md."
        raise ContractError(expected(f"{part}.…", "settings it has", came, do)) from error
    return decoded


def teleoperator_names() -> dict[str, str]:
    """Return short name → registered name; ours (``keyboard`` → ``uniforce_keyboard``) come before LeRobot's."""
    known = list(TeleoperatorConfig.get_known_choices())
    ours = {name.removeprefix("uniforce_"): name for name in known if name.startswith("uniforce_")}
    return {name: name for name in known} | ours


def device_settings(part: str, config: RobotConfig | TeleoperatorConfig) -> dict[str, Any]:
    """Return the settings of ``robot`` or ``teleop`` by dotted name, as a dataset may store them."""
    kind = RobotConfig if isinstance(config, RobotConfig) else TeleoperatorConfig
    return plain_settings(part, draccus.encode(config, kind))


def make_teleoperator(config: TeleoperatorConfig) -> Teleoperator:
    """Return the teleoperator, not connected; ContractError where LeRobot can't build it."""
    try:
        return make_teleoperator_from_config(config)
    except (ValueError, ImportError) as error:
        do = "Check its settings and what it needs installed."
        raise ContractError(expected("teleop", "one that can be built", error, do)) from error


def make_robot(config: RobotConfig, teleop: Teleoperator) -> UniforceFranka:
    """Return the robot, not connected, with the stiffness the teleoperator needs while it steers, if it needs one.

    Raises ContractError: the config sets another one, which may be softer.
    """
    franka = cast("UniforceFrankaConfig", config)
    gains = getattr(teleop, "wants_gains", None)
    if gains is not None and franka.gains not in (ROLLOUT, gains):
        do = "Leave robot.gains out, or steer with another teleoperator."
        raise ContractError(expected(f"robot.gains with teleop {teleop.name}", gains, franka.gains, do))
    if gains is not None:
        franka.gains = gains
    return UniforceFranka(franka)
