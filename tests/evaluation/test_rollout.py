"""A rollout ends, and says why, when a sensor is lost or isn't healthy; a broken action moves nothing."""

from typing import Any

import numpy as np
import pytest
from episode_samples import good_trace

from uniforce_vtla.errors import RolloutError, SensorError
from uniforce_vtla.evaluation.arms import row_of
from uniforce_vtla.evaluation.episode import EpisodeResult, EpisodeTrace, empty_trace, score_episode
from uniforce_vtla.evaluation.rollout import roll_out

LOST = SensorError("right finger: no picture")


class Scene:
    """Ten steps; ``fails`` is raised by the method ``at``, once that many steps were taken."""

    task = "wipe"

    def __init__(
        self,
        at: str = "",
        steps: int = 0,
        fails: Exception = LOST,
        trace: EpisodeTrace | None = None,
    ) -> None:
        self.trace, self.moved = trace or good_trace(), 0
        self._at, self._steps, self._fails = at, steps, fails

    def _may_fail(self, here: str) -> None:
        if here == self._at and self.moved >= self._steps:
            raise self._fails

    def reset(self, *, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
        self._may_fail("reset")
        return {}, {}

    def advance(self, action: np.ndarray) -> bool:
        self._may_fail("advance")
        self.moved += 1
        return self.moved == 10

    def observe(self) -> dict[str, Any]:
        self._may_fail("observe")
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
        (Scene("observe", 4), Looks(), 4, "no picture"),
        (Scene("advance", 3), Looks(), 3, "no picture"),
        (Scene("reset"), Looks(), 0, "no picture"),
        (Scene("observe", trace=empty_trace()), Looks(), 2, "no picture"),
        (Scene(trace=empty_trace()), Looks(1, LOST), 0, "no picture"),
        (Scene(), Looks(3, SensorError("not healthy")), 4, "not healthy"),
        (
            Scene(),
            Looks(2, RolloutError("nothing like it was ever demonstrated")),
            2,
            "demonstrated",
        ),
        (Scene("advance", fails=RolloutError("the target is held")), Looks(), 0, "held"),
    ],
)
def test_whatever_stops_the_robot_aborts_the_episode_and_makes_a_row(
    scene: Scene, controller: Looks, moved: int, why: str
) -> None:
    rollout = roll_out(scene, controller, seed=3)
    result, row = rollout.result, row_of(rollout)
    assert result.outcome == "aborted" and why in result.reasons[0] and not result.clean
    assert scene.moved == moved
    assert (row.seed, row.code, row.clean) == (3, "a", False) and np.isfinite(row.residual)


@pytest.mark.parametrize("odd", [np.full((2, 5), np.nan), np.zeros((2, 4)), np.zeros((0, 5))])
def test_a_broken_chunk_is_an_error_and_moves_nothing(odd: np.ndarray) -> None:
    scene = Scene()
    with pytest.raises(RolloutError, match="action chunk"):
        roll_out(scene, Looks(2, odd), seed=3)
    assert scene.moved == 2
