"""Train a force head for one scene: what the eraser's flat handle does to a pad, no small indenter shows.

The shipped heads learn from spheres, edges and pins; a handle that fills the pad looks to them like far more force.
This one learns from simulated wiping with grips and presses of all sizes, on all three sensors at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from tqdm import tqdm

from lerobot_env_uniforce_wiping import LEVELS, WipeEnv, WipeExpert, level_hash
from lerobot_env_uniforce_wiping.disturbance import Nudge
from lerobot_env_uniforce_wiping.hands import TouchSettings
from uniforce_vtla.commands.arguments import parse
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.evaluation.episode import (
    WIPING_PHASE,
    EpisodeTrace,
    ScoreLimits,
    press_events,
    score_episode,
)
from uniforce_vtla.evaluation.finger_estimates import estimate_events
from uniforce_vtla.keys import tactile_name
from uniforce_vtla.probes.zero_shot import POOL, predict, score
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead, ForceRegressor
from uniforce_vtla.tokenizer.head_training import HeadTrainingConfig, train_head
from uniforce_vtla.tokenizer.pooling import pool_latent
from uniforce_vtla.tokenizer.streaming import StreamingEncoder
from uniforce_vtla.tokenizer.weights import checkpoint_folder

SOURCE = "wiping"  # ForceHead.from_pretrained("wiping")
LEFT_SENSORS = ("gelsight", "uskin")  # the right finger wears the TacTip
GRIP_RANGE_N, PRESS_RANGE_N = (4.0, 13.0), (4.0, 14.0)  # from sliding to too deep, from streaks to too hard


@dataclass
class SceneHeadConfig:
    """Let experts of all strengths wipe, train a head on their forces, score it on scenes it never saw.

    Example: uniforce-scene-head scenes=24 out=outputs/force_head_wiping
    """

    level: str = "paper"  # locked level
    scenes: int = 24  # expert episodes to learn from, half of them on each rig
    test_scenes: int = 8  # episodes to score on
    first_seed: int = 70_000  # not used elsewhere; test scenes count up from 71,000
    stretch: int = (
        45  # frames of a training sequence: 1.5 s, so that a head's memory is used to long stretches
    )
    steps: int = 800  # optimiser steps
    tokenizer: str = ""  # checkpoint folder; empty = shipped
    out: str = ""  # the head's folder; empty = the package's own
    results: str = "docs/results/scene_head.json"  # error per sensor on unseen scenes


@dataclass(frozen=True)
class FeltEpisode:
    """One wipe: latents (n, POOL², L) and true forces (n, 3) N per finger, and what happened."""

    latent: dict[str, torch.Tensor]
    force_N: dict[str, np.ndarray]
    sensors: dict[str, str]
    tool_z_m: np.ndarray
    pad_friction: tuple[float, float]
    trace: EpisodeTrace


def felt_episodes(level: str, seeds: range, tokenizer: Tokenizer) -> Iterator[FeltEpisode]:
    """Yield wipes by experts whose grip and press are drawn per scene, the rigs in turns."""
    envs = [WipeEnv(level, left) for left in LEFT_SENSORS]
    for number, seed in enumerate(tqdm(seeds, desc=f"wiping from {seeds.start}", unit="scene")):
        yield _felt_episode(envs[number % len(envs)], seed, tokenizer)


def _felt_episode(env: WipeEnv, seed: int, tokenizer: Tokenizer) -> FeltEpisode:
    rng = np.random.default_rng([seed, 9])
    wanted = TouchSettings(float(rng.uniform(*PRESS_RANGE_N)), float(rng.uniform(*GRIP_RANGE_N)))
    expert, nudge = WipeExpert(settings=wanted), Nudge(seed)
    observation, _ = env.reset(seed=seed)
    expert.reset(env)
    streams = {finger: StreamingEncoder(tokenizer, finger) for finger in FINGERS}
    for finger, stream in streams.items():
        stream.set_reference(_grey(observation["pixels"][tactile_name(finger, reference=True)]))
    latents: dict[str, list[torch.Tensor]] = {finger: [] for finger in FINGERS}
    forces: dict[str, list[np.ndarray]] = {finger: [] for finger in FINGERS}
    heights, done = [], False
    while not done:
        done = env.advance(nudge.apply(expert.act(env)))
        pixels, wrench = env.observe()["pixels"], env.true_wrench()
        for finger, stream in streams.items():
            latents[finger].append(stream.step(_grey(pixels[tactile_name(finger)])).latent)
            forces[finger].append(wrench[finger][:3])
        heights.append(float(env.state[2]))
    return FeltEpisode(
        {f: pool_latent(torch.stack(latents[f]), POOL) for f in FINGERS},
        {f: np.stack(forces[f]) for f in FINGERS},
        env.sensors,
        np.asarray(heights),
        env.scene.pad_friction,
        env.trace,
    )


def _grey(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[..., 0])


def fit(episodes: list[FeltEpisode], stretch: int, steps: int) -> ForceRegressor:
    """Return one head for all sensors, fitted to overlapping stretches of every finger's wipe."""
    pairs = [(e.latent[f], e.force_N[f]) for e in episodes for f in FINGERS]
    z = torch.cat([latent.unfold(0, stretch, stretch // 2).movedim(-1, 1) for latent, _ in pairs])
    forces = [torch.from_numpy(force).unfold(0, stretch, stretch // 2).movedim(-1, 1) for _, force in pairs]
    return train_head(z, torch.cat(forces).numpy(), HeadTrainingConfig(steps=steps), seed=0)


def errors(head: ForceRegressor, episodes: list[FeltEpisode]) -> dict[str, dict[str, list[float]]]:
    """Return sensor → R² and MAE per axis over whole episodes, each read from its first frame on."""
    truth: dict[str, list[np.ndarray]] = {}
    said: dict[str, list[np.ndarray]] = {}
    for episode in episodes:
        for finger in FINGERS:
            truth.setdefault(episode.sensors[finger], []).append(episode.force_N[finger])
            said.setdefault(episode.sensors[finger], []).append(
                predict(head, episode.latent[finger][None])[0]
            )
    return {s: score(np.concatenate(truth[s])[None], np.concatenate(said[s])[None]) for s in truth}


def general_errors(tokenizer: Tokenizer, episodes: list[FeltEpisode]) -> dict[str, Any]:
    """Return the same of the shipped TacTip head, which knows small indenters alone; empty for another tokenizer."""
    general = ForceHead.from_pretrained("tactip")
    return errors(general.model, episodes) if general.tokenizer_hash == tokenizer.hash else {}


def judge(head: ForceRegressor, episode: FeltEpisode) -> dict[str, Any]:
    """Return the truth of one episode beside what its fingers alone say of it."""
    forces = np.stack([predict(head, episode.latent[f][None])[0] for f in FINGERS], axis=1)  # (n, 2, 3)
    trace, truth = episode.trace, score_episode(episode.trace)
    found = estimate_events(trace.time_s, forces, episode.tool_z_m, episode.pad_friction)
    wiping = trace.phase == WIPING_PHASE
    return {
        "slippage": [truth.slippage, bool(found.slippage or found.lost)],
        "press_above_limit": [
            bool(press_events(trace.press_N, trace.time_s, ScoreLimits())),
            bool(found.excess_force),
        ],
        "slip_max_mm": float(trace.slip_mm.max()),
        "press_max_N": [float(trace.press_N.max()), float(found.press_N.max())],
        "press_mae_N": float(np.abs(found.press_N - trace.press_N)[wiping].mean()) if wiping.any() else None,
    }


def make_head(config: SceneHeadConfig) -> dict[str, Any]:
    """Train, score and save the head; return the report."""
    tokenizer = Tokenizer.from_pretrained(config.tokenizer or None)
    first = config.first_seed
    lessons = list(felt_episodes(config.level, range(first, first + config.scenes), tokenizer))
    head = fit(lessons, config.stretch, config.steps)
    tests = list(
        felt_episodes(config.level, range(first + 1000, first + 1000 + config.test_scenes), tokenizer)
    )
    folder = Path(config.out) if config.out else checkpoint_folder(None, f"force_head_{SOURCE}")
    ForceHead(head, SOURCE, tokenizer.hash).save(folder)
    return {
        "what": "simulated; one head for three sensors, scored on scenes, grips and presses it never saw",
        "level": config.level,
        "level_hash": level_hash(LEVELS[config.level]),
        "scenes": config.scenes,
        "test_scenes": config.test_scenes,
        "tokenizer_hash": tokenizer.hash,
        "sensors": errors(head, tests),
        "general_head": general_errors(tokenizer, tests),
        "episodes": [judge(head, episode) for episode in tests],
        "head": str(folder),
    }


def main(argv: list[str] | None = None) -> int:
    """Entry of ``uniforce-scene-head``."""
    config = parse(SceneHeadConfig, argv)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    report = make_head(config)
    path = write_json(Path(config.results), report | provenance())
    for sensor, cell in report["sensors"].items():
        print(f"{sensor:10s} R² {np.round(cell['r2'], 2)}  MAE {np.round(cell['mae_N'], 2)} N (fx, fy, fz)")
    for sensor, cell in report["general_head"].items():
        print(f"{sensor:10s} MAE {np.round(cell['mae_N'], 2)} N by the shipped general head")
    for event in ("slippage", "press_above_limit"):
        agree = sum(truth == said for truth, said in (episode[event] for episode in report["episodes"]))
        print(f"{event}: estimate and truth agree in {agree} of {len(report['episodes'])} episodes")
    print(f"head in {report['head']}; report in {path}")
    return 0
