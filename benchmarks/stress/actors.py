"""Who acts in a cell: a policy, or the expert by the true wrench or by a mounted sensor."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import torch

from benchmarks.stress.disturbed import SCENE_OPERATORS, Disturbance, DisturbedEnv
from benchmarks.stress.readings import ReadsWorn, shipped_reader
from benchmarks.stress.row import Row
from benchmarks.stress.stock import StockController
from benchmarks.stress.warning import first_event_s
from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import run_script
from lerobot_policy_pi05_uniforce.controller import PolicyController
from uniforce_cli.boundary import worker_process
from uniforce_cli.score_settings import Rig
from uniforce_cli.score_worker import policy_on_rig
from uniforce_vtla.errors import SensorError
from uniforce_vtla.evaluation.arms import whose_turn
from uniforce_vtla.evaluation.episode import EpisodeResult
from uniforce_vtla.evaluation.rollout import roll_out


@dataclass(frozen=True)
class Arm:
    """An actor, and the sensor of its right finger."""

    name: str
    sensor: str = "tactip:1"  # in words
    # stock: any LeRobot policy of cameras and state; expert: by the true wrench; reads: by the
    # mounted sensor
    acts: Literal["policy", "stock", "expert", "reads"] = "policy"
    policies: tuple[str, ...] = ()  # checkpoint folders that take turns
    calibration: str = ""  # folder; of a policy's sensor
    # the sensor was calibrated with its fault: folder CALIBRATION+FAULT=DOSE
    refitted: bool = False
    monitor: Literal["stop", "off"] = "stop"  # of a policy's sensor
    few: bool = False  # acts in the first scenes alone


def play(
    arm: Arm, level: str, words: str, operator: str, dose: float, cell: str, seed: int, first: int
) -> Row:
    """Let an arm act in one scene with a sensor in words, under an operator of the scene if any.

    An episode that a refused sensor stops counts as aborted.
    """
    worker_process()
    torch.manual_seed(seed)
    disturbance = Disturbance()
    if operator in SCENE_OPERATORS:
        disturbance = SCENE_OPERATORS[operator].disturb(dose)
    act = {"policy": _policy, "stock": _stock, "expert": _expert, "reads": _reads}[arm.acts]
    try:
        env, result = act(arm, level, words, disturbance, seed, first)
    except SensorError:  # the reference is refused: nothing is done, as on a robot
        return Row(cell, seed, False, "aborted", 0.0, False, False)
    return row_of(cell, env, result)


def row_of(cell: str, env: WipeEnv, result: EpisodeResult) -> Row:
    """Return what is kept of an episode."""
    return Row(
        cell,
        env.scene.seed,
        bool(result.clean),
        result.outcome,
        float(result.metrics.get("in_band_share", 0.0)),
        bool(result.slippage),
        bool(result.excess_force),
        round(float(result.metrics.get("duration_s", 0.0)), 3),
        first_event_s(env.trace, env.limits),
    )


Played = tuple[WipeEnv, EpisodeResult]


def _policy(
    arm: Arm, level: str, words: str, disturbance: Disturbance, seed: int, first: int
) -> Played:
    calibration = arm.calibration
    if arm.refitted:
        calibration += words.removeprefix(arm.sensor)
    rig = Rig(level, right_sensor=words, right_calibration=calibration, monitor=arm.monitor)
    controller = _controller(whose_turn(seed - first, arm.policies), rig)
    env = DisturbedEnv(
        disturbance,
        level,
        rig.mounted["left"],
        rig.mounted["right"],
        drawn=controller.reads,
        expose_wrench=controller.needs_true_wrench,
    )
    return env, roll_out(env, controller, seed).result


@lru_cache(maxsize=64)
def _controller(policy: str, rig: Rig) -> PolicyController:
    return policy_on_rig(policy, rig)[1]


def _stock(
    arm: Arm, level: str, words: str, disturbance: Disturbance, seed: int, first: int
) -> Played:
    env = DisturbedEnv(disturbance, level, right_sensor=words, drawn=())
    controller = _stock_controller(whose_turn(seed - first, arm.policies))
    return env, roll_out(env, controller, seed).result


_stock_controller = lru_cache(maxsize=8)(StockController)


def _expert(
    arm: Arm, level: str, words: str, disturbance: Disturbance, seed: int, first: int
) -> Played:
    env = DisturbedEnv(disturbance, level, right_sensor=words, drawn=())
    return env, run_script(env, WipeExpert(), seed)


def _reads(
    arm: Arm, level: str, words: str, disturbance: Disturbance, seed: int, first: int
) -> Played:
    env = DisturbedEnv(disturbance, level, right_sensor=words, drawn=("right",))
    return env, run_script(env, ReadsWorn("right", *shipped_reader()), seed)
