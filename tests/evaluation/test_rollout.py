"""A rollout ends, and says why, when a sensor is lost or isn't healthy; a broken action moves
nothing."""

from unittest import mock

import numpy as np
import pytest
from episode_samples import good_trace

from uniforce_vtla.errors import RolloutError, SensorError
from uniforce_vtla.evaluation.arms import row_of
from uniforce_vtla.evaluation.episode import empty_trace, score_episode
from uniforce_vtla.evaluation.rollout import roll_out

LOST = SensorError("right finger: no picture")
STILL = np.zeros((2, 5))


def scene(trace=None, **answers):
    """A scene of ten steps; ``answers`` say what its methods return or raise instead, call by
    call."""
    trace = trace or good_trace()
    env = mock.Mock(trace=trace, task="wipe", result=lambda: score_episode(trace))
    env.configure_mock(**{"reset.return_value": ({}, {}), "observe.return_value": {}})
    env.advance.side_effect = [*[False] * 9, True]
    for name, answer in answers.items():
        getattr(env, name).side_effect = answer
    return env


def looks(*chunks):
    """A controller that answers these chunks, or stands still."""
    controller = mock.Mock()
    controller.chunk.side_effect = chunks or [STILL] * 5
    controller.facts.return_value = {"looks": 5}
    return controller


def test_an_episode_runs_to_its_end():
    rollout = roll_out(scene(), looks(), seed=3)
    assert rollout.result.success and len(rollout.think_ms) == 5 and rollout.facts == {"looks": 5}


@pytest.mark.parametrize(
    "scene, controller, steps, why",
    [
        (scene(observe=[{}, LOST]), looks(), 4, "no picture"),
        (scene(advance=[False, False, False, LOST]), looks(), 4, "no picture"),
        (scene(reset=LOST), looks(), 0, "no picture"),
        (scene(empty_trace(), observe=LOST), looks(), 2, "no picture"),
        (scene(empty_trace()), looks(LOST), 0, "no picture"),
        (scene(), looks(STILL, STILL, SensorError("not healthy")), 4, "not healthy"),
        (scene(), looks(STILL, RolloutError("never demonstrated")), 2, "demonstrated"),
        (scene(advance=RolloutError("the target is held")), looks(), 1, "held"),
    ],
)
def test_whatever_stops_the_robot_aborts_the_episode_and_makes_a_row(scene, controller, steps, why):
    rollout = roll_out(scene, controller, seed=3)
    result, row = rollout.result, row_of(rollout)
    assert result.outcome == "aborted" and why in result.reasons[0] and not result.clean
    assert scene.advance.call_count == steps
    assert (row.seed, row.code, row.clean) == (3, "a", False) and np.isfinite(row.residual)


@pytest.mark.parametrize("odd", [np.full((2, 5), np.nan), np.zeros((2, 4)), np.zeros((0, 5))])
def test_a_broken_chunk_is_an_error_and_moves_nothing(odd):
    env = scene()
    with pytest.raises(RolloutError, match="action chunk"):
        roll_out(env, looks(STILL, odd), seed=3)
    assert env.advance.call_count == 2
