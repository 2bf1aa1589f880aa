"""Fit the cleverest scripts on other scenes: stiffness, press from height, an observer."""

import itertools
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from joblib import Parallel, delayed
from tqdm import tqdm

from benchmarks.gates.blind import (
    BlindScript,
    BlindSettings,
    MeasuredPress,
    MeasuredRelative,
    OpenLoopRegulator,
)
from benchmarks.gates.observer import seen, train_observer
from benchmarks.gates.readings import sunk_m
from benchmarks.gates.scripts import LagIdentifying, LagLaw
from lerobot_env_uniforce_wiping.env import WipeEnv
from lerobot_env_uniforce_wiping.episodes import run_script, walk
from lerobot_env_uniforce_wiping.expert import AGAINST_PULL, ExpertTouch, WipeExpert
from lerobot_env_uniforce_wiping.levels import Layout
from lerobot_env_uniforce_wiping.sequence import Regulator

# wanted presses of the episodes that are learnt from, so that press differs from one to the next
PRESS_N = (4.0, 8.5)


# what scripts without touch may choose from, at nominal stiffness: a nominal width yields, so it
# needs more grip
INK = 10  # column of what an observer sees
PRESSES_N = (4.0, 5.0, 6.0, 7.0)
STYLES: dict[str, tuple[Callable[[Layout, BlindSettings], Regulator], tuple[float, float]]] = {
    "open loop": (OpenLoopRegulator, (11.0, 13.0)),
    "measured press": (MeasuredPress, (11.0, 13.0)),
    "measured relative": (MeasuredRelative, (6.5, 8.5)),
}


@dataclass(frozen=True)
class Fitted:
    """Learnt values; all of them from scenes that are scored nowhere."""

    set_points: dict[str, BlindSettings]  # of each style, the best of the sweep
    arm: LagLaw
    gripper: LagLaw
    plane_stiffness_N_m: float
    plane_rest_m: float
    observer_r2: float
    observer_ink_r2: float


def fit(
    level: str, gripper: str, episodes: int, swept: int, first_seed: int, workers: int, folder: Path
) -> Fitted:
    """Return what scripts learn on ``episodes`` scenes, set points on ``swept``; kept in folder."""
    path = folder / "fitted.json"
    if path.is_file():
        stored = json.loads(path.read_text())
        for style, point in stored["set_points"].items():
            stored["set_points"][style] = BlindSettings(**point)
        for law in ("arm", "gripper"):
            stored[law] = LagLaw(**stored[law])
        return Fitted(**stored)
    folder.mkdir(parents=True, exist_ok=True)
    seeds = range(first_seed, first_seed + episodes)
    jobs = [delayed(_observe)(level, gripper, seed) for seed in seeds]
    found = _all(jobs, workers, "scenes to learn from")
    set_points = _sweep(level, gripper, seeds[:swept], workers)
    stiffness, rest = _line(found)
    r2 = {}
    for name in ("observer", "observer_ink"):
        data = []
        for one in found:
            looked = one.seen.copy()
            if name == "observer":
                looked[:, INK] = 0
            data.append((looked, one.press_N))
        model, r2[name] = train_observer(data)
        torch.save(model.state_dict(), folder / f"{name}.pt")
    arm = _law([(one.lag_s[0], one.scale[0]) for one in found if one.lag_s[0]])
    hand = _law([(one.lag_s[1], one.scale[1]) for one in found if one.lag_s[1]])
    fitted = Fitted(set_points, arm, hand, stiffness, rest, r2["observer"], r2["observer_ink"])
    path.write_text(json.dumps(asdict(fitted)))
    return fitted


def _all(jobs: list[Any], workers: int, desc: str) -> list[Any]:
    found = Parallel(workers, return_as="generator")(jobs)
    return list(tqdm(found, total=len(jobs), desc=desc))


def _sweep(level: str, gripper: str, seeds: range, workers: int) -> dict[str, BlindSettings]:
    """Return each style's set points that wiped most scenes clean, then by in-band share."""
    tried = []
    jobs = []
    for style, (_, grips) in STYLES.items():
        for press, grip in itertools.product(PRESSES_N, grips):
            settings = BlindSettings(press, grip)
            tried.append((style, settings))
            jobs += [delayed(_try)(level, gripper, style, settings, seed) for seed in seeds]
    found = np.array(_all(jobs, workers, "set points"))
    scores = found.reshape(len(tried), len(seeds), 2).mean(axis=1)
    best = {}
    for index in np.lexsort((scores[:, 1], scores[:, 0])):  # the best comes last and stays
        style, settings = tried[index]
        best[style] = settings
    return best


def _try(
    level: str, gripper: str, style: str, settings: BlindSettings, seed: int
) -> tuple[float, float]:
    env = WipeEnv(level=level, drawn=(), gripper=gripper)
    result = run_script(env, BlindScript(settings, STYLES[style][0]), seed)
    return float(result.clean), result.metrics["in_band_share"]


@dataclass(frozen=True)
class Observation:
    """One scene: an expert's episode step by step, and the lags of a script in free air."""

    seen: np.ndarray  # (T, 11)
    press_N: np.ndarray  # (T,)
    sunk_m: np.ndarray  # (T,)
    lag_s: tuple[float | None, float | None]  # arm, gripper
    scale: tuple[float, float]  # their true stiffnesses over nominal


def _observe(level: str, gripper: str, seed: int) -> Observation:
    env = WipeEnv(level=level, drawn=(), gripper=gripper)
    rng = np.random.default_rng([seed, 77])
    settings = AGAINST_PULL if env.level.pull else ExpertTouch()
    expert = WipeExpert(settings=replace(settings, press_N=float(rng.uniform(*PRESS_N))))
    looked = []
    press = []
    sunk = []
    grasp_m = np.nan
    for _ in walk(env, expert, seed):
        if expert.phase in ("descend", "close"):
            grasp_m = float(env.state[2])
        looked.append(seen(env, ink=True))
        press.append(env.sim.press_N)
        sunk.append(sunk_m(env, grasp_m))
    regulators: list[LagIdentifying] = []

    def style(layout: Layout, settings: BlindSettings) -> LagIdentifying:
        regulators.append(LagIdentifying(layout, settings))
        return regulators[-1]

    script = BlindScript(BlindSettings(press_N=7.0, grip_N=13.0), style)
    for _ in walk(env, script, seed):
        if script.phase == "wipe":
            break
    lags = regulators[-1].arm.lag_s, regulators[-1].gripper.lag_s
    scales = float(env.scene.stiffness_scale), float(env.scene.gripper_gain)
    return Observation(np.array(looked), np.array(press, np.float32), np.array(sunk), lags, scales)


def _line(found: list[Observation]) -> tuple[float, float]:
    """Return stiffness N/m and rest m of press = stiffness · (rest + sunk), while it presses."""
    sunk = np.concatenate([one.sunk_m for one in found])
    press = np.concatenate([one.press_N for one in found])
    pressing = (press > 0.5) & np.isfinite(sunk)
    # by their spreads: the board's unevenness would flatten a line of least squares
    stiffness = press[pressing].std() / sunk[pressing].std()
    return float(stiffness), float(press[pressing].mean() / stiffness - sunk[pressing].mean())


def _law(pairs: list[tuple[float | None, float]]) -> LagLaw:
    if len(pairs) < 2:
        return LagLaw(0.0, 0.0)
    lag, scale = np.log(np.array(pairs, dtype=np.float64)).T
    b, a = np.polyfit(lag, scale, 1)
    return LagLaw(float(a), float(b))
