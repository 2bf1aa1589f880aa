"""A rollout as a film: how long it is, what stands where, where its cursor is."""

from dataclasses import replace

import numpy as np
import pytest
from episode_samples import N, good_trace

from uniforce_vtla.evaluation.episode import EpisodeResult, empty_trace
from uniforce_vtla.evaluation.film import FILM_HZ, PICTURE_PX, PLOT_PX, WIDTH_PX, film
from uniforce_vtla.evaluation.rollout import Rollout, Shot


@pytest.fixture
def rollout():
    """Four seconds; the camera is dark in the first two and bright in the others."""
    grey = np.full((6, 8, 3), 128, np.uint8)
    shots = []
    for step in range(0, N, 2):
        front = np.full((8, 8, 3), 255 * (step >= N // 2), np.uint8)
        shots.append(Shot(step, front, grey))
    result = EpisodeResult("success", False, False, ())
    return Rollout(0, result, good_trace(), np.zeros(1), shots)


def test_it_plays_in_real_time_and_shows_the_moment(rollout):
    frames = list(film(rollout, (4.0, 8.0)))
    assert len(frames) == 4 * FILM_HZ
    assert {frame.shape for frame in frames} == {(PICTURE_PX + PLOT_PX, WIDTH_PX, 3)}
    cameras = [frame[0, 0, 0] for frame in frames]
    assert cameras == 2 * FILM_HZ * [0] + 2 * FILM_HZ * [255]
    assert all(frame[0, -1, 0] == 128 for frame in frames), "markers stand beside the camera"


def test_its_cursor_moves_to_the_right(rollout):
    columns = []
    for frame in film(rollout, (4.0, 8.0)):
        above_the_axis = frame[PICTURE_PX + 30, :, 0]
        columns.append(int(np.flatnonzero(above_the_axis == 0).max()))
    assert columns == sorted(columns)
    assert columns[-1] > columns[0] + WIDTH_PX // 2


def test_a_policy_without_touch_has_the_camera_alone(rollout):
    shots = [replace(shot, markers=None) for shot in rollout.shots]
    first = next(film(replace(rollout, shots=shots), (4.0, 8.0)))
    assert not first[:PICTURE_PX, PICTURE_PX:].any()


def test_an_episode_that_ended_before_its_first_step_has_one_frame(rollout):
    """The first chunk may be refused: a camera was seen, and nothing moved."""
    ended = replace(rollout, trace=empty_trace(), shots=rollout.shots[:1])
    assert len(list(film(ended, (4.0, 8.0)))) == 1
