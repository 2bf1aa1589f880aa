"""The scripted expert's demonstrations in the simulated scene; seeds repeat exactly."""

import itertools
import logging
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.rewrite import Rewrite
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.rig_settings import Settings
from uniforce_robots.recorder.assemble import next_seed
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import ContractError, RobotError, SensorError, expected
from uniforce_vtla.evaluation.episode import EpisodeResult
from uniforce_vtla.keys import ACTION, STATE, age_key, time_key, truth_wrench_key

logger = logging.getLogger(__name__)
GIVE_UP_FACTOR = 4  # attempts per wanted episode before a run without failures kept stops


def record_expert(
    env: WipeEnv,
    root: Path,
    repo_id: str,
    episodes: int,
    seed: int,
    keep_failures: bool,
    settings: Settings,
) -> int:
    """Record the missing episodes; return how many are new. See ``uniforce record --help``.

    A scene in which a frame is refused or the tool is lost is left out, and said.

    Raises ContractError: an expert that fails too often; DatasetError: see ``EpisodeRecorder``.
    """
    worn = env.sensors
    fps = int(env.metadata["render_fps"])
    with EpisodeRecorder(root, repo_id, worn["left"], worn["right"], fps) as recorder:
        have = recorder.num_episodes
        first = next_seed(root, have, seed)
        scenes = range(first, first + GIVE_UP_FACTOR * max(episodes - have, 0))
        lost = _record_scenes(env, recorder, episodes, scenes, keep_failures, settings)
        if recorder.num_episodes < episodes:
            wanted = f"{episodes} successes"
            do = f"The last scene left out: {lost}" if lost else "Try an easier level."
            raise ContractError(expected("expert", wanted, recorder.num_episodes, do))
        return recorder.num_episodes - have


def _record_scenes(
    env: WipeEnv,
    recorder: EpisodeRecorder,
    episodes: int,
    scenes: range,
    keep_failures: bool,
    settings: Settings,
) -> str:
    """Record until the episodes are there; return why a scene was left out last, "" if none was."""
    lost = ""
    with tqdm(total=episodes, initial=recorder.num_episodes, desc="record", unit="episode") as bar:
        for seed in scenes:
            try:
                result = record_episode(env, recorder, seed)
            except (SensorError, RobotError) as error:
                recorder.discard()
                lost = str(error)
                logger.warning("seed %d is left out: %s", seed, error)
                continue
            if result.clean or keep_failures:
                recorder.save(result.clean, result.outcome, seed, settings=settings)
            else:
                recorder.discard()
            bar.update(recorder.num_episodes - bar.n)
            bar.set_postfix_str(f"seed {seed}: {'clean ' if result.clean else ''}{result.outcome}")
            if recorder.num_episodes == episodes:
                break
    return lost


def record_episode(env: WipeEnv, recorder: EpisodeRecorder, seed: int) -> EpisodeResult:
    """Let the expert do one episode, its force reading as late as the pads' images.

    Its frames wait in the recorder. Ink comes back in most episodes.
    """
    observation, _ = env.reset(seed=seed)
    expert = WipeExpert(late_steps=max(worn.lag_steps for worn in env.worn.values()))
    rewrite = Rewrite(seed)
    expert.reset(env)
    for step in itertools.count():
        action = np.asarray(expert.act(env), dtype=np.float32)
        recorder.add(_frame(env, observation, action, step), env.task)
        rewrite.apply(env.sim.ink, expert.phase == "wipe")
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            break
    return env.result()


def _frame(
    env: WipeEnv, observation: dict[str, Any], action: np.ndarray, step: int
) -> dict[str, Any]:
    frame = {f"observation.images.{name}": image for name, image in observation["pixels"].items()}
    frame |= {STATE: observation["agent_pos"], ACTION: action}
    for finger, wrench in env.true_wrench().items():
        frame[truth_wrench_key(finger)] = np.asarray(wrench, dtype=np.float32)
    for finger in FINGERS:  # simulated sensors are captured at the observation itself
        frame[time_key(finger)] = np.array([step / env.metadata["render_fps"]])
        frame[age_key(finger)] = np.zeros(1, dtype=np.float32)
    return frame
