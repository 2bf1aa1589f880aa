"""Roll a controller out in an environment: paired seeds in, scored episodes out.

Evaluation never meets a policy class; it is handed a controller, ``action chunk = f(observation)``.
"""

import time
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from uniforce_vtla.errors import RolloutError, SensorError, expected
from uniforce_vtla.evaluation.episode import EpisodeResult, EpisodeTrace


class Environment(Protocol):
    """What a rollout needs of an environment; ``WipeEnv`` is one."""

    trace: EpisodeTrace
    task: str

    def reset(self, *, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start the scene that ``seed`` describes; return observation and info."""

    def advance(self, action: np.ndarray) -> bool:
        """Act for one control step without rendering; return True when the episode is over."""

    def observe(self) -> dict[str, Any]:
        """Render the present observation."""

    def result(self) -> EpisodeResult:
        """Score the episode so far."""


class Controller(Protocol):
    """What acts: a policy checkpoint behind its processors, or a script."""

    def reset(self, env: Environment) -> None:
        """Forget the previous episode."""

    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        """Return the next (n, 5) absolute targets to execute before looking again."""

    def facts(self) -> dict[str, float]:
        """Return its own figures since the last reset: missed deadlines, latencies."""


@dataclass(frozen=True)
class Rollout:
    """One scored episode."""

    seed: int  # the integer that rebuilds the scene
    result: EpisodeResult  # outcome, events and continuous scores, from simulator truth
    trace: EpisodeTrace  # what was measured at each control step
    think_ms: np.ndarray  # controller time per chunk
    # front-camera pictures, one per chunk, when asked for
    frames: list[np.ndarray] = field(default_factory=list)
    # the controller's own figures, e.g. ``missed_deadlines``.
    facts: dict[str, float] = field(default_factory=dict)


def roll_out(env: Environment, controller: Controller, seed: int, keep_frames: bool = False) -> Rollout:
    """Run one episode to its end. Where a sensor is lost or not healthy the robot stops, and the episode is aborted.

    Raises RolloutError: the controller returned a non-finite or misshapen chunk; the robot is not moved by it.
    """
    observation, _ = env.reset(seed=seed)
    controller.reset(env)
    think_ms: list[float] = []
    frames: list[np.ndarray] = []
    done = False

    def finished(result: EpisodeResult) -> Rollout:
        return Rollout(seed, result, env.trace, np.asarray(think_ms), frames, controller.facts())

    def stopped(error: SensorError) -> Rollout:  # so does the robot
        return finished(replace(env.result(), outcome="aborted", reasons=(str(error),)))

    while not done:
        if keep_frames:
            frames.append(observation["pixels"]["front"])
        start = time.perf_counter()
        try:
            chunk = controller.chunk(observation, env.task)
        except SensorError as error:  # a sensor isn't to be trusted
            return stopped(error)
        if chunk.ndim != 2 or chunk.shape[1] != 5 or len(chunk) == 0 or not np.isfinite(chunk).all():
            do = "The robot holds; check the policy."
            raise RolloutError(expected("action chunk", "finite (n ≥ 1, 5)", chunk.shape, do))
        think_ms.append(1e3 * (time.perf_counter() - start))
        done = any(env.advance(action) for action in chunk)  # what comes after the end is not executed
        if not done:
            try:
                observation = env.observe()
            except SensorError as error:  # touch is lost
                return stopped(error)
    return finished(env.result())
