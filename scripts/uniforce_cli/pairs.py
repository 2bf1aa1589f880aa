"""Record equilibrium pairs: a person leads grasps, slow and balanced frames are kept."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import numpy as np
from tqdm import tqdm

from uniforce_cli.boundary import Sensor, command, one_thread, refuse_ignored
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.options import FilePath, OutFolder, Positive, Range, Seed, Share, Text, split
from uniforce_vtla.results_file import provenance, write_json

if TYPE_CHECKING:
    from uniforce_robots.franka import UniforceFrankaConfig
    from uniforce_robots.pairs.recorder import SessionReport, Status
    from uniforce_robots.pairs.rehearsal import SimulatedRig
    from uniforce_robots.pairs.rig import HandLedRig, PairRig
    from uniforce_robots.pairs.storage import PairStore

Several = Annotated[int, Range(2, 1_000_000)]
Mass = Annotated[float, Range(0, 20, above=True)]
Grip = Annotated[float, Range(0, 70, above=True)]
FrameRate = Annotated[int, Range(0, 1000)]
GRASP_s = 3  # of a rehearsed grasp


@dataclass
class RecordPairsConfig:
    """Guide grasps of each indenter until enough pairs are kept; run it again after any stop.

    Example: uniforce pairs left_sensor=gelsight right_sensor=tactip out=outputs/pairs
    A short rehearsal: uniforce pairs pairs=60 indenters=sphere,line out=outputs/pairs_try
    On a robot: uniforce pairs robot=franka rig=rig.yaml mass_kg=0.25 indenters=ball,bar
    ``robot.KEY=…`` and ``rig`` are as for ``uniforce record``; of its cameras only the two fingers
    are read.
    """

    # sim = a rehearsal in the simulator | franka = a Franka arm (never run on hardware)
    robot: Literal["sim", "franka"] = "sim"
    # sim: sensor on the left finger; a robot's rig file names its sensors
    left_sensor: Sensor = "gelsight"
    # sim: sensor on the right finger; a robot's rig file names its sensors
    right_sensor: Sensor = "tactip"
    # franka: YAML or JSON file with `robot: {address: …, guards: …, cameras: …}`
    rig: FilePath = ""
    # names of the objects, in order; for a robot any words; empty = all of pretraining
    indenters: Text = ""
    pairs: Several = 1000  # pairs of each indenter, earlier sessions included
    chunk: Several = 50  # pairs saved at once; a kill loses at most so many
    speed_m_s: Positive = 0.15  # fastest hand, m/s, whose frames are kept
    acceleration_m_s2: Positive = 1.0  # strongest acceleration of the hand whose frames are kept
    # largest share of an indenter's pairs within one bin of force, 0 to 1
    crowded: Share = 0.25
    seed: Seed = 0  # sim: units, grasps and noise; a resumed session takes the next one
    # franka: mass of the object and the moving part of its holder in kg; weigh them
    mass_kg: Mass = 0.2
    grip_N: Grip = 6.0  # franka: force in N that the hand is asked to hold with
    rate_hz: FrameRate = 0  # frames per second; 0 = 15 in simulation, 30 on a robot
    # folder for lerobot/, uniforce_pairs/ and session.json
    out: OutFolder = "outputs/pairs"


def record_pairs(
    config: RecordPairsConfig, robot_flags: Sequence[str] = (), given: Collection[str] = ()
) -> dict[str, Any]:
    """Record what is missing and return the session's report.

    ``robot_flags`` are ``--robot.KEY=…``, ``given`` the settings that were named.

    Raises ContractError: an unknown robot or indenter, impossible numbers, a rig without two
    fingers, or settings that would change nothing; DatasetError: see ``PairStore`` and
    ``PairRecorder``.
    """
    from uniforce_robots.pairs.storage import PairStore

    names = _check(config, robot_flags, given)
    robot = None
    rate_hz = 15
    if config.robot == "franka":
        robot = _robot(config, robot_flags)
        rate_hz = 30
    rate_hz = config.rate_hz or rate_hz
    out = Path(config.out)
    with PairStore(out, config.left_sensor, config.right_sensor, names, rate_hz) as store:
        rig, report = _run(config, robot, store, rate_hz)
        covered = [coverage.covered for coverage in store.coverage]
        content: dict[str, Any] = {
            "config": asdict(config),
            "pairs": dict(zip(store.indenters, store.counts.tolist(), strict=True)),
            "frames": dict(report.outcomes),
            "covered": dict(zip(store.indenters, covered, strict=True)),
            "dataset": str(store.dataset),
            "layout": str(store.layout),
        }
        if config.robot == "sim":
            content["truth"] = _truth(rig, report)  # type: ignore[arg-type]
    write_json(out / "session.json", content | provenance())
    return content


def _run(
    config: RecordPairsConfig, robot: UniforceFrankaConfig | None, store: PairStore, rate_hz: float
) -> tuple[PairRig, SessionReport]:
    from uniforce_robots.pairs.recorder import PairRecorder, RecordingPlan
    from uniforce_robots.pairs.track import MotionLimits

    limits = MotionLimits(config.speed_m_s, config.acceleration_m_s2)
    plan = RecordingPlan(config.pairs, config.chunk, limits, crowded=config.crowded)

    def saved() -> int:
        return int(np.minimum(store.counts, config.pairs).sum())

    wanted = config.pairs * len(store.indenters)
    with (
        tqdm(total=wanted, initial=saved(), unit="pair") as bar,
        _rig(config, robot, store, rate_hz) as rig,
    ):
        report = PairRecorder(rig, store, plan, _status_shown(bar, store, config.pairs)).run()
        bar.update(saved() - bar.n)
    return rig, report


def _rig(
    config: RecordPairsConfig, robot: UniforceFrankaConfig | None, store: PairStore, rate_hz: float
) -> AbstractContextManager[PairRig]:
    if robot is not None:
        return _robot_rig(config, robot, rate_hz)
    from uniforce_robots.pairs.guided_grasp import GraspSettings
    from uniforce_robots.pairs.rehearsal import Rehearsal, SimulatedRig

    seed = config.seed + store.next_session  # other grasps than those recorded before
    settings = GraspSettings(rate_hz=rate_hz, frames=round(GRASP_s * rate_hz))
    rehearsal = Rehearsal(config.left_sensor, config.right_sensor, seed, settings)
    return nullcontext(SimulatedRig(rehearsal))


def _robot(config: RecordPairsConfig, flags: Sequence[str]) -> UniforceFrankaConfig:
    """Read the rig, keep its fingers alone, and take their sensors' names from it."""
    from uniforce_robots.franka.limits import HandSettings
    from uniforce_robots.recorder.build import read_devices
    from uniforce_vtla.contracts import FINGERS

    robot = cast("UniforceFrankaConfig", read_devices(flags, True, "hand_guide", config.rig)[0])
    sensors = {}
    cameras = {}
    came = []
    for name, finger in robot.fingers.items():
        sensors[finger.finger] = finger.sensor
        cameras[name] = replace(finger, reference_on_connect=True)
        came.append(f"{name}: {finger.label}")
    if sensors.keys() != set(FINGERS) or len(cameras) > len(sensors):
        do = "Name both among robot.cameras of rig=FILE, see docs/recording.md."
        raise ContractError(
            expected("tactile fingers of the rig", "a left and a right one", came, do)
        )
    config.left_sensor = sensors["left"]
    config.right_sensor = sensors["right"]
    robot.cameras = cameras
    force_N = robot.gripper.grip_force_N
    if force_N not in (HandSettings().grip_force_N, config.grip_N):
        do = "Leave the rig's out; grip_N is the force here."
        wanted = f"grip_N={config.grip_N:g}"
        raise ContractError(expected("robot.gripper.grip_force_N", wanted, force_N, do))
    robot.gripper = replace(robot.gripper, grip_force_N=config.grip_N)
    return robot


@contextmanager
def _robot_rig(
    config: RecordPairsConfig, robot_config: UniforceFrankaConfig, rate_hz: float
) -> Iterator[HandLedRig]:
    """Connect keyboard, fingers and a soft Franka led by hand, and let go of them in the end.

    Never run on hardware. The fingers' references are taken while connecting, in free air.
    """
    from uniforce_robots.pairs.rig import HandLedRig
    from uniforce_robots.recorder.build import make_robot
    from uniforce_robots.sensors.finger import TactileFinger
    from uniforce_robots.teleop import UniforceHandGuide, UniforceHandGuideConfig
    from uniforce_vtla.keys import AXES

    guide = UniforceHandGuide(UniforceHandGuideConfig())
    robot = make_robot(robot_config, guide)

    def steer(measured: np.ndarray) -> None:
        """Let the soft arm follow the hand that leads it, frame by frame."""
        guide.send_feedback(dict(zip(AXES, measured.tolist(), strict=True)))
        robot.send_action(guide.get_action())

    with ExitStack() as stack:
        guide.connect()
        stack.callback(guide.disconnect)
        robot.connect()
        stack.callback(robot.disconnect)
        guide.start_from(robot.measured())
        fingers: dict[Any, TactileFinger] = {}
        sensors: dict[Any, str] = {}
        for camera in robot.cameras.values():
            if isinstance(camera, TactileFinger):
                fingers[camera.config.finger] = camera
                sensors[camera.config.finger] = camera.config.sensor
        yield HandLedRig(
            robot, fingers, sensors, rate_hz, config.mass_kg, config.grip_N, steer=steer
        )


def _status_shown(bar: tqdm, store: PairStore, wanted: int) -> Callable[[Status], None]:
    """Return a function that shows the live status beside the bar."""

    def show(status: Status) -> None:
        bar.set_description_str(f"indenter {status.indenter}/{len(store.indenters)} {status.name}")
        others = np.delete(store.counts, status.indenter - 1).clip(max=wanted)
        bar.update(int(others.sum()) + status.have - bar.n)
        balance = f"{status.have}/{wanted}, off balance {status.error:.0%}"
        missing = status.coverage.missing()
        bar.set_postfix_str(f"{balance}, {status.reason or 'good'}; missing: {missing}")

    return show


def _truth(rig: SimulatedRig, report: SessionReport) -> dict[str, Any]:
    """Return how good the pairs kept in this session are: only a rehearsal knows."""
    from uniforce_robots.pairs.rehearsal import LIMIT

    error = np.array([rig.truths[grasp].error[k] for grasp, k in report.kept])
    if not len(error):
        return {"kept": 0}
    return {
        "kept": len(error),
        "out_of_balance": float((error > LIMIT).mean()),
        "median_error": float(np.median(error)),
    }


IGNORED = {"sim": ("rig", "mass_kg", "grip_N"), "franka": ("left_sensor", "right_sensor", "seed")}


def _check(
    config: RecordPairsConfig, robot_flags: Sequence[str], given: Collection[str]
) -> tuple[str, ...]:
    from uniforce_vtla.contact.indenters import HEIGHTS, PRETRAIN

    ignored = [name for name in IGNORED[config.robot] if name in given]
    if config.robot == "sim":
        ignored += robot_flags
    refuse_ignored(f"robot={config.robot}", ignored)
    names = tuple(split(config.indenters)) or PRETRAIN
    unknown = set(names) - set(HEIGHTS)
    if config.robot == "franka":
        unknown = set()
    if unknown or len(set(names)) < len(names):
        found = sorted(unknown) or config.indenters
        raise ContractError(expected("indenters", " | ".join(HEIGHTS), found, "Name each once."))
    return names


@command(RecordPairsConfig, others=("robot.",))
def main(config: RecordPairsConfig, robot_flags: Sequence[str], given: Sequence[str]) -> None:
    one_thread()
    content = record_pairs(config, robot_flags, given)
    print(f"{sum(content['pairs'].values())} pairs in {content['dataset']} and {content['layout']}")
    if "truth" in content and content["truth"]["kept"]:
        bad = content["truth"]["out_of_balance"]
        print(f"rehearsal, by truth: {bad:.1%} of those kept now are out of balance")
    print(f"next: uniforce pretrain preset=nano run.pairs={content['layout']}")
    print(f"session in {Path(config.out) / 'session.json'}")
