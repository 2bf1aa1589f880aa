"""A rollout ends, and says why, when a sensor is lost or isn't healthy; a broken action moves nothing."""

import numpy as np
import pytest
from episode_samples import good_trace

from uniforce_vtla.errors import RolloutError, SensorError
from uniforce_vtla.evaluation.arms import row_of
from uniforce_vtla.evaluation.episode import empty_trace, score_episode
from uniforce_vtla.evaluation.rollout import roll_out

LOST = SensorError("right finger: no picture")


class Scene:
    """Ten steps; ``fails`` is raised by the method ``at``, once that many steps were taken."""

    task = "wipe"

    def __init__(self, at="", steps=0, fails=LOST, trace=None):
        self.trace, self.moved = trace or good_trace(), 0
        self._at, self._steps, self._fails = at, steps, fails

    def _may_fail(self, here):
        if here == self._at and self.moved >= self._steps:
            raise self._fails

    def reset(self, *, seed):
        self._may_fail("reset")
        return {}, {}

    def advance(self, action):
        self._may_fail("advance")
        self.moved += 1
        return self.moved == 10

    def observe(self):
        self._may_fail("observe")
        return {}

    def result(self):
        return score_episode(self.trace)


class Looks:
    """A controller that answers chunks of two, and something else from its ``odd_at``-th look on."""

    def __init__(self, odd_at=99, odd=None):
        self._looks, self._odd_at, self._odd = 0, odd_at, odd

    def reset(self, env):
        self._looks = 0

    def facts(self):
        return {"looks": self._looks}

    def chunk(self, observation, task):
        self._looks += 1
        if self._looks < self._odd_at:
            return np.zeros((2, 5))
        if isinstance(self._odd, Exception):
            raise self._odd
        return np.asarray(self._odd)


def test_an_episode_runs_to_its_end():
    rollout = roll_out(Scene(), Looks(), seed=3)
    assert rollout.result.success and len(rollout.think_ms) == 5 and rollout.facts == {"looks": 5}


@pytest.mark.parametrize(
    "scene, controller, moved, why",
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
def test_whatever_stops_the_robot_aborts_the_episode_and_makes_a_row(scene, controller, moved, why):
    rollout = roll_out(scene, controller, seed=3)
    result, row = rollout.result, row_of(rollout)
    assert result.outcome == "aborted" and why in result.reasons[0] and not result.clean
    assert scene.moved == moved
    assert (row.seed, row.code, row.clean) == (3, "a", False) and np.isfinite(row.residual)


@pytest.mark.parametrize("odd", [np.full((2, 5), np.nan), np.zeros((2, 4)), np.zeros((0, 5))])
def test_a_broken_chunk_is_an_error_and_moves_nothing(odd):
    scene = Scene()
    with pytest.raises(RolloutError, match="action chunk"):
        roll_out(scene, Looks(2, odd), seed=3)
    assert scene.moved == 2
