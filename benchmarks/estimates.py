"""How well a robot's own fingers judge a wipe: estimates beside the simulator's truth.

Experts of all strengths wipe, some so loosely that the tool slips. Both fingers are read as a
policy feels them, and ``uniforce estimate`` judges by what they read.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.probes.zero_shot import score
from lerobot_env_uniforce_wiping import LEVELS, WipeEnv, WipeExpert, level_hash
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_env_uniforce_wiping.expert import ExpertTouch
from uniforce_cli.boundary import Level, command, one_thread
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.evaluation.episode import (
    WIPING_PHASE,
    EpisodeTrace,
    ScoreLimits,
    press_events,
    score_episode,
)
from uniforce_vtla.evaluation.finger_estimates import estimate_events
from uniforce_vtla.force_sensor import ForceSensor
from uniforce_vtla.keys import tactile_name
from uniforce_vtla.options import Count, OutFile, Seed
from uniforce_vtla.results_file import provenance, write_json

LEFT_SENSORS = ("gelsight", "uskin")  # the right finger wears the TacTip
# from sliding to too deep, from streaks to too hard
GRIP_RANGE_N = (4.0, 13.0)
PRESS_RANGE_N = (4.0, 14.0)


@dataclass
class EstimatesConfig:
    """Let experts of all strengths wipe; compare what the fingers say with the truth.

    Example: python -m benchmarks.estimates scenes=4
    """

    level: Level = "touch"  # locked level
    scenes: Count = 32  # episodes, half of them with each left sensor
    first_seed: Seed = 71_000  # spent: heads that left were scored on these scenes too
    out: OutFile = "outputs/estimates.json"  # error per sensor, verdict per episode


@dataclass(frozen=True)
class FeltWipe:
    """One wipe of n frames: what the fingers read and bore, and what happened."""

    force_N: np.ndarray  # (n, 2, 3) left, right, as read
    true_force_N: np.ndarray  # (n, 2, 3)
    tool_m: np.ndarray  # (n, 3)
    sensors: dict[str, str]  # by finger
    pad_friction: tuple[float, float]
    trace: EpisodeTrace


def felt_wipe(env: WipeEnv, sensors: dict[Finger, ForceSensor], seed: int) -> FeltWipe:
    """Return a wipe by an expert whose grip and press are drawn."""
    rng = np.random.default_rng([seed, 9])
    wanted = ExpertTouch(float(rng.uniform(*PRESS_RANGE_N)), float(rng.uniform(*GRIP_RANGE_N)))
    read: list[list[np.ndarray]] = []
    true: list[list[np.ndarray]] = []
    places = []
    for _ in walk(env, WipeExpert(settings=wanted), seed):
        pixels = env.observe()["pixels"]
        wrench = env.true_wrench()
        read.append([read_now(pixels, sensors[finger]) for finger in FINGERS])
        true.append([wrench[finger][:3] for finger in FINGERS])
        places.append(env.state[:3])
    return FeltWipe(
        np.array(read, np.float64),
        np.array(true, np.float64),
        np.array(places, np.float64),
        env.sensors,
        env.scene.pad_friction,
        env.trace,
    )


def read_now(pixels: dict[str, np.ndarray], sensor: ForceSensor) -> np.ndarray:
    """Return (3,) N of what a finger shows, canonical frame."""
    reference = pixels[tactile_name(sensor.finger, reference=True)][..., 0]
    current = pixels[tactile_name(sensor.finger)][..., 0]
    return sensor.newtons(sensor.encode(reference[None], current[None]))[0].numpy()


def errors(wipes: list[FeltWipe]) -> dict[str, dict[str, list[float]]]:
    """Return by sensor R² and MAE per axis, over every finger that wore it."""
    read: dict[str, list[np.ndarray]] = {}
    true: dict[str, list[np.ndarray]] = {}
    for wipe in wipes:
        for column, finger in enumerate(FINGERS):
            kind = wipe.sensors[finger]
            read.setdefault(kind, []).append(wipe.force_N[:, column])
            true.setdefault(kind, []).append(wipe.true_force_N[:, column])
    found = {}
    for kind in read:
        found[kind] = score(np.concatenate(true[kind])[None], np.concatenate(read[kind])[None])
    return found


def judge(wipe: FeltWipe) -> dict[str, Any]:
    """Return the truth of one episode beside what its fingers alone say of it."""
    trace = wipe.trace
    truth = score_episode(trace)
    found = estimate_events(trace.time_s, wipe.force_N, wipe.tool_m, wipe.pad_friction)
    off_N = np.abs(found.press_N - trace.press_N)[trace.phase == WIPING_PHASE]
    pressed_hard = press_events(trace.press_N, trace.time_s, ScoreLimits())
    return {
        "sensors": wipe.sensors,
        "slippage": [truth.slippage, bool(found.slippage or found.lost)],
        "press_above_limit": [bool(pressed_hard), bool(found.excess_force)],
        "slip_max_mm": float(trace.slip_mm.max()),
        "press_max_N": [float(trace.press_N.max()), float(found.press_N.max())],
        "in_band_share": [truth.metrics["in_band_share"], found.in_band_share],
        "press_mae_N": float(off_N.mean()) if len(off_N) else None,
    }


def measure(config: EstimatesConfig) -> dict[str, Any]:
    """Return errors by sensor and verdicts by episode; the left sensors take turns."""
    envs = []
    for left in LEFT_SENSORS:
        # a hand that holds by its own force doesn't grip as loosely as is asked
        envs.append(WipeEnv(config.level, f"{left}:any", "tactip:any", gripper="servo"))
    sensors: dict[Finger, ForceSensor] = {f: ForceSensor("", f) for f in FINGERS}
    wipes = []
    for number in tqdm(range(config.scenes), desc="wiping", unit="scene"):
        seed = config.first_seed + number
        wipes.append(felt_wipe(envs[number % len(envs)], sensors, seed))
    return {
        "what": "simulated, contact by finite elements, a hand that follows each width; "
        "newtons as a policy feels them",
        "level": config.level,
        "level_hash": level_hash(LEVELS[config.level]),
        "read_by": sensors["left"].facts(),
        "sensors": errors(wipes),
        "episodes": [judge(wipe) for wipe in wipes],
    }


@command(EstimatesConfig)
def main(config: EstimatesConfig) -> None:
    one_thread()
    report = measure(config)
    path = write_json(Path(config.out), report | provenance())
    for sensor, cell in report["sensors"].items():
        r2 = np.round(cell["r2"], 2)
        print(f"{sensor:10s} R² {r2}  MAE {np.round(cell['mae_N'], 2)} N (fx, fy, fz)")
    episodes = report["episodes"]
    for event in ("slippage", "press_above_limit"):
        told = np.array([episode[event] for episode in episodes])
        agree = (told[:, 0] == told[:, 1]).sum()
        print(f"{event}: estimate and truth agree in {agree} of {len(told)} episodes")
    shares = np.array([episode["in_band_share"] for episode in episodes])
    print(f"in-band share: off by {np.abs(np.diff(shares, axis=1)).mean():.3f} in the mean")
    if wanted := LEVELS[config.level].in_band_share:
        agree = (np.diff(shares >= wanted, axis=1) == 0).sum()
        print(f"share of {wanted:g} reached: they agree in {agree} of {len(shares)} episodes")
    print(f"written to {path}")


if __name__ == "__main__":
    sys.exit(main())
