"""A rollout ends, and says why, when a sensor is lost or isn't healthy; a broken action moves nothing."""

from typing import Any

import numpy as np
import pytest
from episode_samples import good_trace

from uniforce_vtla.errors import RolloutError, SensorError
from uniforce_vtla.evaluation.episode import EpisodeResult, score_episode
from uniforce_vtla.evaluation.rollout import roll_out


class Scene:
    """Ten steps; its sensor is lost at ``lost_at``."""

    task = "wipe"

    def __init__(self, lost_at: int = 99) -> None:
        self.trace, self.moved, self._lost_at = good_trace(), 0, lost_at

    def reset(self, *, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
        return {}, {}

    def advance(self, action: np.ndarray) -> bool:
        self.moved += 1
        return self.moved == 10

    def observe(self) -> dict[str, Any]:
        if self.moved >= self._lost_at:
            raise SensorError("right finger: no picture")
        return {}

    def result(self) -> EpisodeResult:
        return score_episode(self.trace)


class Looks:
    """A controller that answers chunks of two, and something else from its ``odd_at``-th look on."""

    def __init__(self, odd_at: int = 99, odd: Exception | np.ndarray | None = None) -> None:
        self._looks, self._odd_at, self._odd = 0, odd_at, odd

    def reset(self, env: Any) -> None:
        self._looks = 0

    def facts(self) -> dict[str, float]:
        return {"looks": self._looks}

    def chunk(self, observation: dict[str, Any], task: str) -> np.ndarray:
        self._looks += 1
        if self._looks < self._odd_at:
            return np.zeros((2, 5))
        if isinstance(self._odd, Exception):
            raise self._odd
        return np.asarray(self._odd)


def test_an_episode_runs_to_its_end() -> None:
    rollout = roll_out(Scene(), Looks(), seed=3)
    assert rollout.result.success and len(rollout.think_ms) == 5 and rollout.facts == {"looks": 5}


@pytest.mark.parametrize(
    ("scene", "controller", "moved", "why"),
    [
        (Scene(lost_at=4), Looks(), 4, "no picture"),
        (Scene(), Looks(3, SensorError("not healthy")), 4, "not healthy"),
    ],
)
def test_a_sensor_that_is_lost_or_not_healthy_stops_the_robot_and_aborts(
    scene: Scene, controller: Looks, moved: int, why: str
) -> None:
    result = roll_out(scene, controller, seed=3).result
    assert result.outcome == "aborted" and why in result.reasons[0] and not result.clean
    assert scene.moved == moved


@pytest.mark.parametrize("odd", [np.full((2, 5), np.nan), np.zeros((2, 4)), np.zeros((0, 5))])
def test_a_broken_chunk_is_an_error_and_moves_nothing(odd: np.ndarray) -> None:
    scene = Scene()
    with pytest.raises(RolloutError, match="action chunk"):
        roll_out(scene, Looks(2, odd), seed=3)
    assert scene.moved == 2
