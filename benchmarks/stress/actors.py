"""Who acts in a cell of the curves, and one of its episodes."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from benchmarks.calibrations import calibration_folder
from benchmarks.ladder.plan import GRIPPER, LEVEL
from benchmarks.stress.disturbed import DisturbedEnv
from benchmarks.stress.faults import FAULTS, NOTHING, SCALES
from benchmarks.stress.readings import ReadsWorn, shipped_reader
from benchmarks.stress.row import Row, row_of
from lerobot_env_uniforce_wiping.episodes import run_script
from lerobot_policy_pi05_uniforce.controller import PolicyController
from uniforce_cli.boundary import worker_process
from uniforce_cli.score_settings import Rig
from uniforce_cli.score_worker import policy_on_rig
from uniforce_vtla.errors import SensorError
from uniforce_vtla.evaluation.rollout import roll_out

SENSOR = "tactip:1"  # of the demonstrations


@dataclass(frozen=True)
class Actor:
    """A policy, or the expert that reads the same sensor."""

    is_policy: bool
    is_weighed: bool = False  # its sensor was weighed through the tool, with a fault of its scale


ACTORS = {
    "policy": Actor(True),
    "policy, sensor weighed": Actor(True, is_weighed=True),
    "expert that reads it": Actor(False),
}


def play(cell: str, actor: str, policy: str, fault: str, dose: float, seed: int, work: Path) -> Row:
    """Let an actor wipe one scene; a reference that is refused ends it as aborted.

    Args:
        cell: name of the row.
        actor: key of ``ACTORS``.
        policy: checkpoint folder.
        fault: key of ``FAULTS``; "" = none.
        dose: of the fault.
        seed: of the scene.
        work: folder of the calibrations.
    """
    worker_process()
    torch.manual_seed(seed)
    words = SENSOR
    disturbance = NOTHING
    if fault:
        words += FAULTS[fault].words(dose)
        disturbance = FAULTS[fault].scene(dose)
    who = ACTORS[actor]
    options: dict[str, Any] = {"gripper": GRIPPER}
    try:
        if not who.is_policy:
            env = DisturbedEnv(disturbance, LEVEL, right_sensor=words, drawn=("right",), **options)
            return row_of(cell, env, run_script(env, ReadsWorn("right", *shipped_reader()), seed))
        calibration = ""
        if who.is_weighed:
            weighed = words if fault in SCALES else SENSOR
            calibration = str(calibration_folder(weighed, "tool", work))
        rig = Rig(LEVEL, "gelsight", words, right_calibration=calibration, **options)
        controller = _controller(policy, rig)
        env = DisturbedEnv(disturbance, LEVEL, "gelsight", words, drawn=controller.reads, **options)
        return row_of(cell, env, roll_out(env, controller, seed).result)
    except SensorError:  # nothing is done, as on a robot
        return Row(cell, seed, False, "aborted", 0.0, False, False)


@lru_cache(maxsize=64)
def _controller(policy: str, rig: Rig) -> PolicyController:
    return policy_on_rig(policy, rig)[1]
