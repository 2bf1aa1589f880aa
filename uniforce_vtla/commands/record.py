"""Record demonstrations of the wiping task as a LeRobot dataset."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from uniforce_vtla.commands.arguments import parse
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import ContractError, UniForceError, expected
from uniforce_vtla.keys import ACTION, STATE, age_key, time_key, truth_wrench_key

if TYPE_CHECKING:
    from lerobot_env_uniforce_wiping import WipeEnv
    from uniforce_datasets.recorder import EpisodeRecorder
    from uniforce_vtla.evaluation.episode import EpisodeResult

GIVE_UP_FACTOR = 4  # attempts per wanted episode before a run without failures kept stops


@dataclass
class RecordConfig:
    """Record demos until the dataset holds ``episodes`` of them; run it again to go on after any stop.

    Example: uniforce-record episodes=50 level=paper left_sensor=gelsight root=outputs/demos
    """

    robot: str = "sim"  # sim (franka: not in this release)
    teleop: str = "expert"  # expert = the scripted one
    episodes: int = 50  # wanted in the dataset, earlier sessions included
    level: str = "paper"  # easy | paper | hard, locked in the environment package
    left_sensor: str = "gelsight"  # gelsight | tactip | uskin
    right_sensor: str = "tactip"  # gelsight | tactip | uskin
    root: str = "outputs/demos"  # the dataset's folder
    repo_id: str = "local/uniforce_wiping"  # LeRobot's name for it; nothing is uploaded
    seed: int = 0  # scene of the first episode; the next ones count up
    nudge: float = 1.3  # hidden push on the executed target, so that demos hold recoveries; 0 = none
    keep_failures: bool = True  # failed demos are kept, labelled; training views leave them out


def record(config: RecordConfig) -> Path:
    """Record what is missing and return the dataset's folder.

    Raises:
        ContractError: a robot or teleoperator this release doesn't have, an unknown sensor or level.
        DatasetError: see ``EpisodeRecorder``.
    """
    _check(config)
    from lerobot_env_uniforce_wiping import WipeEnv
    from uniforce_datasets.recorder import EpisodeRecorder

    env = WipeEnv(config.level, config.left_sensor, config.right_sensor)
    fps = int(env.metadata["render_fps"])
    try:
        with EpisodeRecorder(
            config.root, config.repo_id, config.left_sensor, config.right_sensor, fps
        ) as recorder:
            _fill(config, env, recorder)
    finally:
        env.close()
    return Path(config.root)


def _fill(config: RecordConfig, env: WipeEnv, recorder: EpisodeRecorder) -> None:
    have = recorder.num_episodes
    seeds = iter(range(_next_seed(config, have), 2**31))
    attempts = GIVE_UP_FACTOR * max(config.episodes - have, 0)
    with tqdm(total=config.episodes, initial=have, desc="record", unit="episode") as bar:
        while recorder.num_episodes < config.episodes and attempts > 0:
            attempts -= 1
            seed = next(seeds)
            result = record_episode(env, recorder, seed, config.nudge)
            _keep(config, recorder, result, seed)
            bar.update(recorder.num_episodes - bar.n)
            bar.set_postfix_str(f"seed {seed}: {'clean ' if result.clean else ''}{result.outcome}")
    if recorder.num_episodes < config.episodes:
        raise ContractError(
            expected("expert", f"{config.episodes} successes", recorder.num_episodes, "Try an easier level.")
        )


def _next_seed(config: RecordConfig, have: int) -> int:
    """Seeds go on where the last session stopped."""
    if not have:
        return config.seed
    from uniforce_datasets.source import read_source
    from uniforce_vtla.keys import SEED

    return int(read_source(config.root).columns((SEED,))[SEED].max()) + 1


def record_episode(env: WipeEnv, recorder: EpisodeRecorder, seed: int, nudge: float) -> EpisodeResult:
    """Let the expert do one episode; its frames wait in the recorder.

    Row t: observation and command at t, the command without the nudge that was added to it.
    """
    from lerobot_env_uniforce_wiping import WipeExpert
    from lerobot_env_uniforce_wiping.disturbance import Nudge

    expert, push = WipeExpert(), Nudge(seed, nudge)
    observation, _ = env.reset(seed=seed)
    expert.reset(env)
    for step in _until_done():
        action = np.asarray(expert.act(env), dtype=np.float32)
        recorder.add(_frame(env, observation, action, step), env.task)
        observation, _, terminated, truncated, _ = env.step(push.apply(action))
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


def _keep(config: RecordConfig, recorder: EpisodeRecorder, result: EpisodeResult, seed: int) -> None:
    if result.clean or config.keep_failures:
        recorder.save(success=result.clean, outcome=result.outcome, seed=seed)
    else:
        recorder.discard()


def _check(config: RecordConfig) -> None:
    if config.robot != "sim":
        do = "Real robots are not in this release: use robot=sim."
        raise ContractError(expected("robot", "sim", repr(config.robot), do))
    if config.teleop != "expert":
        do = "Other teleoperators come with the real robots."
        raise ContractError(expected("teleop", "expert", repr(config.teleop), do))
    if config.nudge < 0:
        raise ContractError(expected("nudge", "≥ 0", config.nudge, "0 records an undisturbed expert."))
    if config.episodes < 1:
        raise ContractError(expected("episodes", "≥ 1", config.episodes, "Ask for some."))


def main(argv: list[str] | None = None) -> int:
    """Entry of ``uniforce-record``."""
    os.environ.setdefault("HF_HUB_OFFLINE", "1")
    config = parse(RecordConfig, argv)
    try:
        root = record(config)
    except UniForceError as error:
        print(f"record: {error}")
        return 2
    print(f"demos in {root} (LeRobot v3 dataset {config.repo_id})")
    print(f"next: uniforce-view roots={root} out={root.parent / 'view'}")
    return 0
