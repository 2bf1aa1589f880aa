"""Record demonstrations as a LeRobot dataset, from the robot or from the simulated scene."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from uniforce_cli.boundary import (
    Gripper,
    Level,
    Worn,
    changed,
    command,
    one_thread,
    refuse_ignored,
)
from uniforce_vtla import options
from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.terminal import LastingText

if TYPE_CHECKING:
    from lerobot.robots import RobotConfig
    from lerobot.teleoperators import Teleoperator

    from uniforce_robots.recorder.operators import Operator
    from uniforce_robots.recorder.rig import Rig
    from uniforce_robots.recorder.session import SessionEnd

INFO_KEYS = ("codebase_version", "fps", "features")  # LeRobot opens no dataset without them
PLACES = ("root", "resume", "rig")  # that mean something on this machine only
INTERRUPTED = 130  # exit code of a program that Ctrl-C ended
EpisodeSeconds = Annotated[float, options.Range(0, 3600, above=True)]


@dataclass
class RecordConfig:
    """Record demos until the dataset holds ``episodes`` of them; run it again after any stop.

    Simulation, scripted: uniforce record episodes=50 level=touch left_sensor=gelsight
    Simulation, by hand:  uniforce record teleop=keyboard root=outputs/by_hand
    Robot, for example:   uniforce record robot=franka rig=rig.yaml teleop=gello root=outputs/real
    ``robot.KEY=…`` and ``teleop.KEY=…`` are LeRobot's own settings of both; ``rig`` is a file with
    them. The keys to press are in docs/recording.md. Exit codes: 0 done, 2 could not start, 3 a
    fault, 4 disk full, 130 interrupted: by Ctrl-C, kill or a closed terminal, which end an episode
    in order.
    """

    robot: Literal["sim", "franka"] = "sim"  # the simulated scene, or a Franka arm
    # who steers: expert (a script, in simulation) | keyboard | spacemouse | gello | hand_guide
    teleop: options.FileName = "expert"
    # YAML or JSON file with `robot: {type: …, cameras: …}` and, if wanted, `teleop: {…}`
    rig: options.FilePath = ""
    # episodes that the dataset should hold, earlier sessions included; aborted ones don't count
    episodes: options.Count = 50
    level: Level = "touch"  # simulation: level of the scene
    # simulation: sensor on the left finger: gelsight = unit 1 | gelsight:7 = unit 7 |
    # gelsight:any = another unit in every scene | gelsight:drawing = as drawn, no camera, fast. A
    # robot's rig file names its sensors
    left_sensor: Worn = "gelsight"
    # simulation: sensor on the right finger: tactip = unit 1 | tactip:7 = unit 7 | tactip:any =
    # another unit in every scene | tactip:drawing = as drawn, no camera, fast. A robot's rig file
    # names its sensors
    right_sensor: Worn = "tactip"
    # simulation: hand = holds by force, as the robot's hand does | servo = follows every tenth of a
    # millimetre, as no hand does
    gripper: Gripper = "hand"
    root: options.OutFolder = "outputs/demos"  # the dataset's folder
    # folder of a dataset to go on with; refused where there is none
    resume: options.Dataset = ""
    # LeRobot's name for the dataset; nothing is uploaded
    repo_id: options.HubName = "local/uniforce_wiping"
    seed: options.Seed = 0  # scene of a new dataset's first episode; the next ones count up
    # expert: failed demos are kept, labelled; training views leave them out
    keep_failures: bool = True
    # instructions, in turn; none = the scene's own
    prompts: options.Texts = field(default_factory=list)
    episode_s: EpisodeSeconds = 60.0  # time limit of an episode in s
    # who begins and judges an episode: keys = a person | unattended = nobody
    operator: Literal["keys", "unattended"] = "keys"
    # operator=unattended: the label of every episode
    verdict: Literal["success", "residual", "failed_grasp"] = "success"
    quick_notes: options.Texts = field(default_factory=list)  # notes that the digits 1, 2, … add
    drive_between: bool = True  # let the teleoperator move the robot between episodes
    keep_aborted: bool = True  # store the part of an episode before a fault, labelled
    # share of its ticks that an episode may miss; if it misses more, it is aborted as late
    late_share: options.Share = 0.1
    keep_raw: bool = True  # robot: store raw tactile frames beside the dataset
    window: options.Count = 17  # robot: taxel scans per tick; 17 are one tick at 500 Hz
    # when mounts, turns, cameras, gains or other settings of the rig differ from those that the
    # dataset was recorded with
    settings_changed: Literal["refuse", "accept"] = "refuse"
    reserve_MB: options.NotNegative = 500.0  # MB that have to stay free on the disk
    # operator=unattended: seconds to wait for a sensor that isn't well
    unwell_s: options.NotNegative = 10.0
    real_time: bool = True  # simulation by hand: keep to the wall clock


def record(
    config: RecordConfig, device_flags: Sequence[str] = (), given: Collection[str] = ()
) -> SessionEnd:
    """Record what is missing.

    ``device_flags`` are ``--robot.KEY=…`` and ``--teleop.KEY=…``, ``given`` the settings that were
    named, also with the value they have anyway.

    Raises ContractError: a robot, teleoperator, sensor, level or setting that is unknown;
    DatasetError: see ``EpisodeRecorder``; RobotError, SensorError, TeleoperatorError: it can't be
    connected.
    """
    _check(config)
    _refuse_ignored(config, device_flags, given)
    if config.robot == "sim" and config.teleop == "expert":
        return _record_expert(config)
    from uniforce_robots.recorder.assemble import run_session
    from uniforce_robots.recorder.build import device_settings, make_teleoperator, read_devices
    from uniforce_robots.recorder.session import SessionSettings
    from uniforce_robots.recorder.store import StoreSettings

    robot, steering = read_devices(
        device_flags, config.robot == "franka", config.teleop, config.rig
    )
    teleop = make_teleoperator(steering)
    store = StoreSettings(Path(config.root), config.repo_id, config.reserve_MB)
    limits = (config.drive_between, config.unwell_s, config.keep_aborted, config.late_share)
    devices = _rig(config, robot, teleop), teleop, _operator(config, teleop)
    worn = _scene(config) if robot is None else _robot(config, robot)
    rig = worn | device_settings("teleop", steering)
    command = {name: value for name, value in asdict(config).items() if name not in PLACES}
    settings = SessionSettings(
        config.episodes,
        tuple(config.prompts),
        config.episode_s,
        *limits,
        settings={**command, "rig": rig},
        rig=rig,
        accept_changes=config.settings_changed == "accept",
    )
    return run_session(*devices, store, settings, config.seed, sys.stdout)


def _record_expert(config: RecordConfig) -> SessionEnd:
    from lerobot_env_uniforce_wiping import WipeEnv
    from uniforce_datasets.rig_settings import agreed_changes
    from uniforce_robots.recorder.expert_demos import record_expert
    from uniforce_robots.recorder.session import SessionEnd

    settings = _scene(config)
    agreed_changes(options.absolute(config.root), settings, config.settings_changed == "accept")
    env = WipeEnv(config.level, config.left_sensor, config.right_sensor, gripper=config.gripper)
    with closing(env):
        new = record_expert(
            env,
            Path(config.root),
            config.repo_id,
            config.episodes,
            config.seed,
            config.keep_failures,
            settings,
        )
    if not new:
        held = f"{config.root} holds {config.episodes} or more"
        return SessionEnd(0, f"nothing new, {held}; set episodes= or root=")
    return SessionEnd(0, f"{config.episodes} episodes, {new} of them new")


def _scene(config: RecordConfig) -> dict[str, Any]:
    return {f"scene.{name}": getattr(config, name) for name in SCENE}


def _robot(config: RecordConfig, robot: RobotConfig) -> dict[str, Any]:
    from uniforce_robots.recorder.build import device_settings

    return {"keep_raw": config.keep_raw, "window": config.window} | device_settings("robot", robot)


def _operator(config: RecordConfig, teleop: Teleoperator) -> Operator:
    """Return who judges; a teleoperator that reads the terminal itself lends its other keys."""
    from uniforce_robots.recorder.operators import KeyOperator, Unattended
    from uniforce_robots.teleop.keyboard import TerminalKeys

    if config.operator == "unattended":
        return Unattended(config.verdict)
    keys = getattr(teleop, "keys", None)
    if not isinstance(keys, TerminalKeys):
        keys = None
    return KeyOperator(keys, config.quick_notes)


def _rig(config: RecordConfig, robot: RobotConfig | None, teleop: Teleoperator) -> Rig:
    if robot is None:
        from lerobot_env_uniforce_wiping import WipeEnv
        from uniforce_robots.recorder.sim_rig import SimRig

        max_steps = round(config.episode_s * WipeEnv.metadata["render_fps"])
        env = WipeEnv(
            config.level,
            config.left_sensor,
            config.right_sensor,
            max_steps=max_steps,
            gripper=config.gripper,
        )
        return SimRig(env, config.real_time)
    from uniforce_robots.recorder.build import make_robot
    from uniforce_robots.recorder.robot_rig import RobotRig

    return RobotRig(make_robot(robot, teleop), config.window, config.keep_raw)


def _check(config: RecordConfig) -> None:
    if config.robot == "franka" and config.teleop == "expert":
        do = "The expert reads the scene's truth: steer a robot by keyboard, spacemouse, gello, …"
        raise ContractError(expected("teleop", "one that works on a robot", "expert", do))
    if config.robot == "franka" and not config.prompts:
        do = 'Say what is done, e.g. prompts=["wipe the whiteboard with 6 N"].'
        raise ContractError(expected("prompts", "an instruction or more", "none", do))
    if config.resume:  # a damaged dataset is named before anything is logged
        file = Path(config.resume) / "meta" / "info.json"
        info = read_object(file, DatasetError)
        missing = [key for key in INFO_KEYS if key not in info]
        if missing:
            do = "Restore it from a copy, or record into a new folder."
            raise DatasetError(expected(str(file), list(INFO_KEYS), f"no {missing}", do))
    config.root = config.resume or config.root


ROBOT = ("rig", "keep_raw", "window")
SCENE = ("level", "left_sensor", "right_sensor", "gripper")
BY_HAND = (
    "prompts",
    "episode_s",
    "operator",
    "verdict",
    "quick_notes",
    "drive_between",
    "keep_aborted",
)
EXPERT = ("keep_failures",)
IGNORED = {  # by how it records: settings that would change nothing
    "robot=franka": (*SCENE, *EXPERT, "real_time"),
    "robot=sim teleop=expert": (
        *ROBOT,
        *BY_HAND,
        "late_share",
        "reserve_MB",
        "unwell_s",
        "real_time",
    ),
    "robot=sim, steered by hand": (*ROBOT, *EXPERT),
    "operator=keys": ("verdict", "unwell_s"),
    "operator=unattended": ("quick_notes", "drive_between"),
}


def _refuse_ignored(
    config: RecordConfig, device_flags: Sequence[str], given: Collection[str]
) -> None:
    """Refuse what was set and would change nothing."""
    operator = f"operator={config.operator}"
    if config.robot == "franka":
        mode = "robot=franka"
        devices: tuple[str, ...] = ()
    elif config.teleop == "expert":
        mode = "robot=sim teleop=expert"
        devices = ("--robot.", "--teleop.")
        operator = ""
    else:
        mode = "robot=sim, steered by hand"
        devices = ("--robot.",)
    names = (*IGNORED[mode], *IGNORED.get(operator, ()))
    set_so = {*given, *changed(config, names)}
    ignored = [name for name in names if name in set_so]
    ignored += [flag for flag in device_flags if flag.startswith(devices)]
    refuse_ignored(f"{mode} {operator}".strip(), ignored)


def _saved(config: RecordConfig) -> int:
    """Return how many episodes the dataset holds."""
    info = Path(config.root) / "meta" / "info.json"
    return int(read_object(info, DatasetError)["total_episodes"]) if info.is_file() else 0


@command(RecordConfig, others=("robot.", "teleop."))
def main(config: RecordConfig, flags: Sequence[str], given: Sequence[str]) -> int:
    os.environ.setdefault("HF_HUB_OFFLINE", "1")
    if config.robot == "sim":
        one_thread()
    out = LastingText(sys.stdout)
    try:
        end = record(config, flags, given)
    except KeyboardInterrupt:
        stopped = "" if config.robot == "sim" else "; the robot has stopped"
        saved = f"{_saved(config)} of {config.episodes} episodes are saved and whole"
        print(f"record: interrupted{stopped}. {saved}: run it again to go on", file=out)
        return INTERRUPTED
    print(f"record: {end.message}", file=out)
    print(f"demos in {config.root} (LeRobot v3 dataset {config.repo_id})", file=out)
    view = Path(config.root).parent / "view"
    print(f"next: uniforce view roots={config.root} out={view}", file=out)
    return end.exit_code
