"""Make the heads that score recordings of one scene: newtons from hand descriptors.

Experts of all strengths wipe in simulation; what their pads showed and bore is what a head learns.
The shipped force heads won't do: they read the tokenizer a policy may act on, and they know small
indenters alone, so that a handle which fills the pad looks like far more force.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tqdm import tqdm

from benchmarks.probes.zero_shot import score
from lerobot_env_uniforce_wiping import LEVELS, WipeEnv, WipeExpert, level_hash
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_env_uniforce_wiping.expert import TouchSettings
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
from uniforce_vtla.keys import tactile_name
from uniforce_vtla.options import Count, OutFile, OutFolder, Range, Seed
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.descriptor import descriptors
from uniforce_vtla.tokenizer.descriptor_head import DescriptorHead

LEFT_SENSORS = ("gelsight", "uskin")  # the right finger wears the TacTip
# from sliding to too deep, from streaks to too hard
GRIP_RANGE_N = (4.0, 13.0)
PRESS_RANGE_N = (4.0, 14.0)


Scenes = Annotated[int, Range(2, 10_000)]  # half of them on each rig


@dataclass
class DescriptorHeadsConfig:
    """Let experts of all strengths wipe, fit a head per sensor, score it on scenes it never saw.

    Example: python -m benchmarks.descriptor_heads scenes=60 out=outputs/descriptor_heads
    """

    level: Level = "touch"  # locked level
    scenes: Scenes = 60  # expert episodes to learn from, half of them on each rig
    test_scenes: Count = 32  # episodes to score on
    first_seed: Seed = 70_000  # not used elsewhere; test scenes count up from 71,000
    # frames of a training sequence: 1.5 s, so that a head's memory is used to long stretches
    stretch: Count = 45
    steps: Count = 1600  # optimiser steps
    out: OutFolder = "outputs/descriptor_heads"  # folder of heads
    # error per sensor on unseen scenes
    results: OutFile = "outputs/descriptor_heads/descriptor_heads.json"


Wipe = tuple[np.ndarray, np.ndarray]  # hand descriptors (n, 6) and true forces (n, 3) N


@dataclass(frozen=True)
class EpisodeForces:
    """One wipe: what each finger showed and bore, and what happened."""

    fingers: dict[Finger, Wipe]
    sensors: dict[str, str]
    tool_m: np.ndarray  # (n, 3)
    pad_friction: tuple[float, float]
    trace: EpisodeTrace


def described_episodes(level: str, seeds: range) -> list[EpisodeForces]:
    """Return wipes by experts whose grip and press are drawn per scene, the rigs in turns."""
    envs = [WipeEnv(level, f"{left}:any", "tactip:any") for left in LEFT_SENSORS]
    found = []
    for number, seed in enumerate(tqdm(seeds, desc=f"wiping from {seeds.start}", unit="scene")):
        found.append(_described_episode(envs[number % len(envs)], seed))
    return found


def _described_episode(env: WipeEnv, seed: int) -> EpisodeForces:
    rng = np.random.default_rng([seed, 9])
    wanted = TouchSettings(float(rng.uniform(*PRESS_RANGE_N)), float(rng.uniform(*GRIP_RANGE_N)))
    described: dict[Finger, list[np.ndarray]] = {finger: [] for finger in FINGERS}
    forces: dict[Finger, list[np.ndarray]] = {finger: [] for finger in FINGERS}
    places = []
    for _ in walk(env, WipeExpert(settings=wanted), seed):
        pixels = env.observe()["pixels"]
        wrench = env.true_wrench()
        for finger in FINGERS:
            described[finger].append(described_now(pixels, finger))
            forces[finger].append(wrench[finger][:3])
        places.append(env.state[:3])
    return EpisodeForces(
        {finger: (np.stack(described[finger]), np.stack(forces[finger])) for finger in FINGERS},
        env.sensors,
        np.asarray(places, np.float64),
        env.scene.pad_friction,
        env.trace,
    )


def described_now(pixels: dict[str, np.ndarray], finger: Finger) -> np.ndarray:
    """Return the (6,) hand descriptor of what a finger shows."""
    reference = pixels[tactile_name(finger, reference=True)][..., 0]
    return descriptors(reference, pixels[tactile_name(finger)][None, ..., 0], finger)[0]


def worn(episodes: list[EpisodeForces]) -> dict[str, list[Wipe]]:
    """Return sensor → what every finger that wore it showed and bore."""
    found: dict[str, list[Wipe]] = {}
    for episode in episodes:
        for finger in FINGERS:
            found.setdefault(episode.sensors[finger], []).append(episode.fingers[finger])
    return found


def errors(head: DescriptorHead, wipes: list[Wipe]) -> dict[str, list[float]]:
    """Return R² and MAE per axis over whole episodes, each read from its first frame on."""
    said = np.concatenate([head.read(described) for described, _ in wipes])
    truth = np.concatenate([force_N for _, force_N in wipes])
    return score(truth[None], said[None])


def judge(heads: dict[str, DescriptorHead], episode: EpisodeForces) -> dict[str, Any]:
    """Return the truth of one episode beside what its fingers alone say of it."""
    read = []
    for finger in FINGERS:
        read.append(heads[episode.sensors[finger]].read(episode.fingers[finger][0]))
    trace = episode.trace
    truth = score_episode(trace)
    forces = np.stack(read, axis=1)  # (n, 2, 3)
    found = estimate_events(trace.time_s, forces, episode.tool_m, episode.pad_friction)
    wiping = trace.phase == WIPING_PHASE
    off_N = np.abs(found.press_N - trace.press_N)[wiping]
    pressed_hard = press_events(trace.press_N, trace.time_s, ScoreLimits())
    return {
        "slippage": [truth.slippage, bool(found.slippage or found.lost)],
        "press_above_limit": [bool(pressed_hard), bool(found.excess_force)],
        "slip_max_mm": float(trace.slip_mm.max()),
        "press_max_N": [float(trace.press_N.max()), float(found.press_N.max())],
        "in_band_share": [truth.metrics["in_band_share"], found.in_band_share],
        "press_mae_N": float(off_N.mean()) if len(off_N) else None,
    }


def make_heads(config: DescriptorHeadsConfig) -> dict[str, Any]:
    first = config.first_seed
    lessons = worn(described_episodes(config.level, range(first, first + config.scenes)))
    heads = {}
    for sensor, wipes in lessons.items():
        heads[sensor] = DescriptorHead.fit(sensor, wipes, config.stretch, config.steps)
        heads[sensor].save(Path(config.out))
    first += 1000
    tests = described_episodes(config.level, range(first, first + config.test_scenes))
    return {
        "what": "simulated; hand descriptors read by a head per sensor, "
        "on scenes, grips and presses it never saw",
        "level": config.level,
        "level_hash": level_hash(LEVELS[config.level]),
        "scenes": config.scenes,
        "test_scenes": config.test_scenes,
        "sensors": {sensor: errors(heads[sensor], wipes) for sensor, wipes in worn(tests).items()},
        "episodes": [judge(heads, episode) for episode in tests],
        "heads": config.out,
    }


@command(DescriptorHeadsConfig)
def main(config: DescriptorHeadsConfig) -> None:
    one_thread()
    report = make_heads(config)
    path = write_json(Path(config.results), report | provenance())
    for sensor, cell in report["sensors"].items():
        r2 = np.round(cell["r2"], 2)
        print(f"{sensor:10s} R² {r2}  MAE {np.round(cell['mae_N'], 2)} N (fx, fy, fz)")
    episodes = report["episodes"]
    for event in ("slippage", "press_above_limit"):
        told = np.array([episode[event] for episode in episodes])
        agree = (told[:, 0] == told[:, 1]).sum()
        print(f"{event}: estimate and truth agree in {agree} of {len(told)} episodes")
    shares = np.array([episode["in_band_share"] for episode in episodes])
    off = np.abs(np.diff(shares, axis=1)).mean()
    print(f"in-band share: estimate off by {off:.3f} in the mean")
    if wanted := LEVELS[config.level].in_band_share:
        agree = (np.diff(shares >= wanted, axis=1) == 0).sum()
        print(f"share of {wanted:g} reached: they agree in {agree} of {len(shares)} episodes")
    print(f"heads in {report['heads']}; report in {path}")


if __name__ == "__main__":
    sys.exit(main())
