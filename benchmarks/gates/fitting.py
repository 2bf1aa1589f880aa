"""Knowledge that the cleverest scripts learn on other scenes: stiffness from lag, press from height, an observer."""

import itertools
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

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
from lerobot_env_uniforce_wiping.expert import AGAINST_PULL, TouchSettings, WipeExpert
from lerobot_env_uniforce_wiping.levels import Layout
from lerobot_env_uniforce_wiping.sequence import Regulator

# wanted presses of the episodes that are learnt from, so that press differs from one to the next
PRESS_N = (4.0, 8.5)


# what scripts without touch may choose from, at nominal stiffness: a nominal width yields, so it needs more grip
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
    """Return what the scripts learn on ``episodes`` scenes, set points on ``swept`` of them; ``folder`` keeps it."""
    path = folder / "fitted.json"
    if path.is_file():
        stored = json.loads(path.read_text())
        points = {
            style: BlindSettings(**point) for style, point in stored.pop("set_points").items()
        }
        return Fitted(
            points, LagLaw(**stored.pop("arm")), LagLaw(**stored.pop("gripper")), **stored
        )
    folder.mkdir(parents=True, exist_ok=True)
    jobs = [
        delayed(_observe)(level, gripper, seed) for seed in range(first_seed, first_seed + episodes)
    ]
    found = list(
        tqdm(
            Parallel(workers, return_as="generator")(jobs),
            total=len(jobs),
            desc="scenes to learn from",
        )
    )
    set_points = _sweep(level, gripper, range(first_seed, first_seed + swept), workers)
    stiffness, rest = _line(found)
    r2 = {}
    for name, ink in (("observer", False), ("observer_ink", True)):
        data = [
            (
                f.seen if ink else np.where(np.arange(11) == 10, 0, f.seen).astype(np.float32),
                f.press_N,
            )
            for f in found
        ]
        model, r2[name] = train_observer(data)
        torch.save(model.state_dict(), folder / f"{name}.pt")
    arm_law = _law([(f.lag_s[0], f.scale[0]) for f in found if f.lag_s[0]])
    gripper_law = _law([(f.lag_s[1], f.scale[1]) for f in found if f.lag_s[1]])
    fitted = Fitted(
        set_points, arm_law, gripper_law, stiffness, rest, r2["observer"], r2["observer_ink"]
    )
    path.write_text(json.dumps(asdict(fitted)))
    return fitted


def _sweep(level: str, gripper: str, seeds: range, workers: int) -> dict[str, BlindSettings]:
    """Return each style's set points that wiped most of the scenes clean, by the mean in-band share where they tie."""
    tried = [
        (style, BlindSettings(press, grip))
        for style, (_, grips) in STYLES.items()
        for press, grip in itertools.product(PRESSES_N, grips)
    ]
    jobs = [
        delayed(_try)(level, gripper, style, settings, seed)
        for style, settings in tried
        for seed in seeds
    ]
    found = list(
        tqdm(Parallel(workers, return_as="generator")(jobs), total=len(jobs), desc="set points")
    )
    scores = np.array(found).reshape(len(tried), len(seeds), 2).mean(axis=1)
    ranked = sorted(zip(scores.tolist(), tried, strict=True), key=lambda pair: pair[0])
    return {style: settings for _, (style, settings) in ranked}  # the best comes last and stays


def _try(
    level: str, gripper: str, style: str, settings: BlindSettings, seed: int
) -> tuple[float, float]:
    result = run_script(
        WipeEnv(level=level, drawn=(), gripper=gripper),
        BlindScript(settings, STYLES[style][0]),
        seed,
    )
    return float(result.clean), result.metrics["in_band_share"]


@dataclass(frozen=True)
class Observation:
    """One scene: what an expert's episode showed step by step, and the lags of a script in free air."""

    seen: np.ndarray  # (T, 11)
    press_N: np.ndarray  # (T,)
    sunk_m: np.ndarray  # (T,)
    lag_s: tuple[float | None, float | None]  # arm, gripper
    scale: tuple[float, float]  # their true stiffnesses over nominal


def _observe(level: str, gripper: str, seed: int) -> Observation:
    env = WipeEnv(level=level, drawn=(), gripper=gripper)
    rng = np.random.default_rng([seed, 77])
    settings = AGAINST_PULL if env.level.pull else TouchSettings()
    expert = WipeExpert(settings=replace(settings, press_N=float(rng.uniform(*PRESS_N))))
    looked, press, sunk, grasp_m = [], [], [], np.nan
    for _ in walk(env, expert, seed):
        if expert.phase in ("descend", "close"):
            grasp_m = float(env.state[2])
        looked.append(seen(env, ink=True))
        press.append(env.sim.press_N)
        sunk.append(sunk_m(env, grasp_m))
    regulators: list[LagIdentifying] = []

    def style(layout, settings):  # type: ignore[no-untyped-def]
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
    sunk, press = (
        np.concatenate([getattr(f, name) for f in found]) for name in ("sunk_m", "press_N")
    )
    pressing = (press > 0.5) & np.isfinite(sunk)
    # by their spreads: least squares would flatten the line by the board's unevenness, and regulate too weakly
    stiffness = press[pressing].std() / sunk[pressing].std()
    return float(stiffness), float(press[pressing].mean() / stiffness - sunk[pressing].mean())


def _law(pairs: list[tuple[float | None, float]]) -> LagLaw:
    if len(pairs) < 2:
        return LagLaw(0.0, 0.0)
    lag, scale = np.log(np.array(pairs, dtype=np.float64)).T
    b, a = np.polyfit(lag, scale, 1)
    return LagLaw(float(a), float(b))
