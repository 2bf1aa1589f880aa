"""From a command line to devices: ``robot.KEY=…``, ``teleop.KEY=…`` as in LeRobot, or a file."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

import draccus
from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig, make_teleoperator_from_config

import uniforce_robots.teleop  # noqa: F401  registers ours
from uniforce_datasets.rig_settings import plain_settings
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka.arm import ROLLOUT
from uniforce_vtla.arguments import (
    Option,
    check,
    decode_file,
    options_of,
    read_value,
    read_yaml,
    refuse_unknown,
    section,
)
from uniforce_vtla.errors import ContractError, expected, require_one_of
from uniforce_vtla.options import check_text

FRANKA = "uniforce_franka"
# LeRobot's own, registered once imported: type → its module, the package it reads with, its extra
STOCK_CAMERAS = {
    "opencv": ("opencv", "cv2", ""),
    "intelrealsense": ("realsense", "pyrealsense2", "intelrealsense"),
    "zmq": ("zmq", "zmq", "pyzmq-dep"),
}


def read_devices(
    flags: Sequence[str], franka: bool, teleop: str, file: str = ""
) -> tuple[RobotConfig | None, TeleoperatorConfig]:
    """Return the configs of robot and teleoperator; no robot means the simulated scene.

    Args:
        flags: ``--robot.KEY=…`` and ``--teleop.KEY=…``; dots lead into nested settings.
        franka: whether there is a robot.
        teleop: a name from ``teleoperator_names``.
        file: of LeRobot's form, with ``robot`` and ``teleop``; flags override it.

    Raises ContractError: an unknown name, an unreadable file, unknown or refused settings.
    """
    names = teleoperator_names()
    require_one_of("teleop", teleop, sorted(names), "Name one, or expert.")
    classes: dict[str, Any] = {"teleop": TeleoperatorConfig.get_choice_class(names[teleop])}
    if franka:
        classes["robot"] = RobotConfig.get_choice_class(FRANKA)
    settings = section(file, read_yaml(Path(file))) if file else {}
    for name in settings:
        require_one_of(file, name, ("robot", "teleop"), "It holds these two sections.")
    types = {"teleop": names[teleop], "robot": FRANKA}
    options: dict[str, Option] = {}
    for part, config_class in classes.items():
        options |= options_of(config_class, f"{part}.")
        settings[part] = section(part, settings.get(part))
        kind = settings[part].pop("type", types[part])
        if part == "robot":
            require_one_of("robot.type", kind, [FRANKA])
        elif names.get(str(kind)) != types[part]:
            settings[part] = {}  # the file's teleoperator isn't the one that was asked for
    _with_flags(settings, flags, options)
    if not franka:
        return None, decode_file(classes["teleop"], "teleop", settings["teleop"])
    cameras = section("robot.cameras", settings["robot"].pop("cameras", None))
    robot = decode_file(classes["robot"], "robot", settings["robot"])
    if robot.touch_in_state:
        do = (
            "Marker images are recorded; `uniforce view touch_in_state=true` reads newtons in them."
        )
        raise ContractError(expected("robot.touch_in_state", "false for a recording", "true", do))
    cameras = {name: _camera(f"robot.cameras.{name}", camera) for name, camera in cameras.items()}
    return replace(robot, cameras=cameras), decode_file(
        classes["teleop"], "teleop", settings["teleop"]
    )


def _with_flags(
    settings: dict[str, Any], flags: Sequence[str], options: Mapping[str, Option]
) -> None:
    """Put flags into the settings, checked as far as their options say what they may be.

    Not through draccus' own parser, which stumbles over unrelated classes.
    """
    names = [flag.removeprefix("--").partition("=")[0] for flag in flags]
    refuse_unknown(
        [name for name in names if not any(name.startswith(f"{o}.") for o in options)], options
    )
    for name, flag in zip(names, flags, strict=True):
        text = flag.partition("=")[2]
        check_text(name, text)
        *path, last = name.split(".")
        inner = settings
        for depth, key in enumerate(path, start=1):
            inner[key] = section(".".join(path[:depth]), inner.get(key))
            inner = inner[key]
        option = options.get(name, Option(name, Any, None))
        inner[last] = read_value(option, text)
        check(option, inner[last])


def _camera(name: str, content: Any) -> CameraConfig:
    """Return a camera's config; ContractError: names the camera and what it lacks."""
    settings = section(name, content)
    kind = str(settings.pop("type", "nothing"))
    if kind in STOCK_CAMERAS:
        module, package, extra = STOCK_CAMERAS[kind]
        if find_spec(package) is None:
            raise ContractError(
                expected(name, f"the package {package}", "none", f"pip install 'lerobot[{extra}]'")
            )
        import_module(f"lerobot.cameras.{module}")
    known = CameraConfig.get_known_choices()
    require_one_of(f"{name}.type", kind, sorted({*known, *STOCK_CAMERAS}))
    camera = decode_file(known[kind], name, settings)
    for size in ("width", "height", "fps"):
        if getattr(camera, size) is None:
            do = "Say what the camera delivers: a dataset needs to know."
            raise ContractError(expected(f"{name}.{size}", "a number", "nothing", do))
    return camera


def teleoperator_names() -> dict[str, str]:
    """Return short → registered name; ours, as ``keyboard``, come before LeRobot's."""
    names = {name: name for name in TeleoperatorConfig.get_known_choices()}
    for name in list(names):
        if name.startswith("uniforce_"):
            names[name.removeprefix("uniforce_")] = name
    return names


def device_settings(part: str, config: RobotConfig | TeleoperatorConfig) -> dict[str, Any]:
    """Return the settings of ``robot`` or ``teleop`` by dotted name, for a dataset."""
    kind = RobotConfig if isinstance(config, RobotConfig) else TeleoperatorConfig
    return plain_settings(part, draccus.encode(config, kind))


def make_teleoperator(config: TeleoperatorConfig) -> Teleoperator:
    """Return the teleoperator, not connected; ContractError where LeRobot can't build it."""
    try:
        return make_teleoperator_from_config(config)
    except Exception as error:  # anybody's constructor
        do = "Check its settings and what it needs installed."
        raise ContractError(expected("teleop", "one that can be built", error, do)) from error


def make_robot(config: RobotConfig, teleop: Teleoperator) -> UniforceFranka:
    """Return the robot, not connected, with the stiffness the teleoperator needs, if any.

    Raises ContractError: the config sets another one, which may be softer.
    """
    franka = cast("UniforceFrankaConfig", config)
    gains = getattr(teleop, "wants_gains", None)
    if gains is not None and franka.gains not in (ROLLOUT, gains):
        do = "Leave robot.gains out, or steer with another teleoperator."
        raise ContractError(
            expected(f"robot.gains with teleop {teleop.name}", gains, franka.gains, do)
        )
    if gains is not None:
        franka.gains = gains
    return UniforceFranka(franka)
