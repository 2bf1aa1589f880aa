"""The scripted expert's demonstrations in the simulated scene: nobody watches, nothing waits, seeds repeat exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.disturbance import Nudge, Rewrite
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.source import read_source
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.episode import EpisodeResult
from uniforce_vtla.keys import ACTION, SEED, STATE, age_key, time_key, truth_wrench_key

GIVE_UP_FACTOR = 4  # attempts per wanted episode before a run without failures kept stops


@dataclass(frozen=True)
class ExpertDemos:
    """What to record; see ``uniforce-record --help`` for each."""

    root: Path
    repo_id: str
    episodes: int
    level: str
    left_sensor: str
    right_sensor: str
    seed: int
    nudge: float
    keep_failures: bool


def record_expert(demos: ExpertDemos) -> None:
    """Record what is missing.

    Raises:
        ContractError: an unknown sensor or level, or an expert that fails too often.
        DatasetError: see ``EpisodeRecorder``.
    """
    env = WipeEnv(demos.level, demos.left_sensor, demos.right_sensor)
    fps = int(env.metadata["render_fps"])
    sensors = demos.left_sensor, demos.right_sensor
    try:
        with EpisodeRecorder(demos.root, demos.repo_id, *sensors, fps) as recorder:
            _fill(demos, env, recorder)
    finally:
        env.close()


def _fill(demos: ExpertDemos, env: WipeEnv, recorder: EpisodeRecorder) -> None:
    have = recorder.num_episodes
    seeds = iter(range(next_seed(demos.root, have, demos.seed), 2**31))
    attempts = GIVE_UP_FACTOR * max(demos.episodes - have, 0)
    with tqdm(total=demos.episodes, initial=have, desc="record", unit="episode") as bar:
        while recorder.num_episodes < demos.episodes and attempts > 0:
            attempts -= 1
            seed = next(seeds)
            result = record_episode(env, recorder, seed, demos.nudge)
            _keep(demos, recorder, result, seed)
            bar.update(recorder.num_episodes - bar.n)
            bar.set_postfix_str(f"seed {seed}: {'clean ' if result.clean else ''}{result.outcome}")
    if recorder.num_episodes < demos.episodes:
        raise ContractError(
            expected("expert", f"{demos.episodes} successes", recorder.num_episodes, "Try an easier level.")
        )


def next_seed(root: Path, have: int, first: int) -> int:
    """Return the seed to go on with: seeds go on where the last session stopped."""
    return int(read_source(root).columns((SEED,))[SEED].max()) + 1 if have else first


def record_episode(env: WipeEnv, recorder: EpisodeRecorder, seed: int, nudge: float) -> EpisodeResult:
    """Let the expert do one episode; its frames wait in the recorder.

    Row t: observation and command at t, the command without the nudge that was added to it.
    """
    expert, push, rewrite = WipeExpert(), Nudge(seed, nudge), Rewrite(seed)
    observation, _ = env.reset(seed=seed)
    expert.reset(env)
    for step in _until_done():
        action = np.asarray(expert.act(env), dtype=np.float32)
        recorder.add(_frame(env, observation, action, step), env.task)
        if nudge:
            rewrite.apply(env.sim.ink, expert.phase == "wipe")
        observation, _, terminated, truncated, _ = env.step(push.apply(action, expert.phase))
        if terminated or truncated:
            break
    return env.result()


def _until_done() -> Iterator[int]:
    step = 0
    while True:
        yield step
        step += 1


def _frame(env: WipeEnv, observation: dict[str, Any], action: np.ndarray, step: int) -> dict[str, Any]:
    frame = {f"observation.images.{name}": image for name, image in observation["pixels"].items()}
    frame |= {STATE: observation["agent_pos"], ACTION: action}
    for finger, wrench in env.true_wrench().items():
        frame[truth_wrench_key(finger)] = np.asarray(wrench, dtype=np.float32)
    for finger in FINGERS:  # simulated sensors are captured at the observation itself
        frame[time_key(finger)] = np.array([step / env.metadata["render_fps"]])
        frame[age_key(finger)] = np.zeros(1, dtype=np.float32)
    return frame


def _keep(demos: ExpertDemos, recorder: EpisodeRecorder, result: EpisodeResult, seed: int) -> None:
    if result.clean or demos.keep_failures:
        recorder.save(success=result.clean, outcome=result.outcome, seed=seed)
    else:
        recorder.discard()
