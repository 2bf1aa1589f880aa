"""Roll a controller out in an environment: paired seeds in, scored episodes out.

Evaluation never meets a policy class; it is handed a controller, ``action chunk = f(observation)``.
"""

import time
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from uniforce_vtla.errors import RobotError, RolloutError, SensorError, expected
from uniforce_vtla.evaluation.episode import EpisodeResult, EpisodeTrace, empty_trace, score_episode
from uniforce_vtla.keys import tactile_name
from uniforce_vtla.markers.raster import overlay


class Environment(Protocol):
    """An environment that can be rolled out; ``WipeEnv`` is one."""

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
    """An actor: a policy checkpoint behind its processors, or a script."""

    def reset(self, env: Environment) -> None:
        """Forget the previous episode."""

    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        """Return the next (n, 5) absolute targets to execute before looking again."""

    def facts(self) -> dict[str, float]:
        """Return its own figures since the last reset: missed deadlines, latencies."""


@dataclass(frozen=True)
class Shot:
    """Pictures of one moment, (H, W, 3) uint8."""

    step: int  # control steps before it
    front: np.ndarray  # the scene's camera
    # markers of the finger that the controller feels with: cyan in free air, red now; None: none
    markers: np.ndarray | None


@dataclass(frozen=True)
class Rollout:
    """One scored episode."""

    seed: int  # the integer that rebuilds the scene
    result: EpisodeResult  # outcome, events and continuous scores, from simulator truth
    trace: EpisodeTrace  # measurements of each control step
    think_ms: np.ndarray  # controller time per chunk
    shots: list[Shot] = field(default_factory=list)  # one per chunk, when asked for
    # the controller's own figures, e.g. ``missed_deadlines``.
    facts: dict[str, float] = field(default_factory=dict)


class ChunkError(RolloutError):
    """A controller's chunk is invalid: a fault of the program, which ends the whole run."""


def roll_out(
    env: Environment, controller: Controller, seed: int, keep_shots: bool = False
) -> Rollout:
    """Run one episode to its end.

    The robot stops and the episode is aborted where a sensor is lost or not healthy, the hand loses
    its tool, or the policy stops. The next episode may go well.

    Raises ChunkError: the controller returned a non-finite or misshapen chunk; it isn't executed.
    """
    think_ms: list[float] = []
    shots: list[Shot] = []
    try:
        observation, _ = env.reset(seed=seed)
    # the environment still holds another episode's trace
    except (SensorError, RolloutError) as error:
        trace = empty_trace()
        return Rollout(seed, _aborted(score_episode(trace), error), trace, np.zeros(0))
    controller.reset(env)
    try:
        _act(env, controller, observation, think_ms, shots if keep_shots else None)
        result = env.result()
    except ChunkError:
        raise
    except (SensorError, RolloutError, RobotError) as error:
        result = _aborted(env.result(), error)
    return Rollout(seed, result, env.trace, np.asarray(think_ms), shots, controller.facts())


def _act(
    env: Environment,
    controller: Controller,
    observation: dict[str, Any],
    think_ms: list[float],
    shots: list[Shot] | None,
) -> None:
    """Look, think and act until the episode is over; add times and pictures to the lists."""
    done = False
    while not done:
        if shots is not None:
            shots.append(_shot(observation["pixels"], len(env.trace.time_s)))
        start = time.perf_counter()
        chunk = controller.chunk(observation, env.task)
        if (
            chunk.ndim != 2
            or chunk.shape[1] != 5
            or len(chunk) == 0
            or not np.isfinite(chunk).all()
        ):
            do = "The robot holds; check the policy."
            raise ChunkError(expected("action chunk", "finite (n ≥ 1, 5)", chunk.shape, do))
        think_ms.append(1e3 * (time.perf_counter() - start))
        # actions after the end are not executed
        done = any(env.advance(action) for action in chunk)
        if not done:
            observation = env.observe()


def _shot(pixels: dict[str, np.ndarray], step: int) -> Shot:
    for finger in ("right", "left"):
        current = pixels.get(tactile_name(finger))
        if current is not None:
            reference = pixels[tactile_name(finger, reference=True)]
            half = overlay(reference[::2, ::2, 0], current[::2, ::2, 0])
            return Shot(step, pixels["front"], half)
    return Shot(step, pixels["front"], None)


def _aborted(result: EpisodeResult, error: Exception) -> EpisodeResult:
    return replace(result, outcome="aborted", reasons=(str(error),))
