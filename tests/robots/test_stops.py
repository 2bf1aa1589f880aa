"""After a stop nothing moves until a new wish, in sessions of any order; see ``make faults``."""

import logging
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from benchmarks.trust.stop_mutations import MUTATIONS, notice
from benchmarks.trust.stop_sessions import explore
from benchmarks.trust.stop_world import BRAKE_s, SimWorld, StandInWorld, Watch
from uniforce_robots.fr3 import rotation_z


def test_after_a_stop_nothing_moves_until_a_new_wish(caplog):
    with caplog.at_level(logging.CRITICAL):
        counts = explore(20, SimWorld)
    assert counts["violations"] == 0 and counts["moved"] > 5, "they did move"


@pytest.mark.thorough
def test_the_same_over_the_stand_in(address, caplog):
    with caplog.at_level(logging.CRITICAL):
        assert explore(1, lambda: StandInWorld(address), steps=22)["violations"] == 0


@pytest.mark.thorough
def test_a_broken_stop_is_noticed():
    assert len(MUTATIONS) >= 12
    name = "hand: goes on at the end of a stream"
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert "after" in pool.submit(notice, name).result()


SHIFTED = np.eye(4)
SHIFTED[0, 3] = 0.0011


@pytest.mark.parametrize(
    "after",
    [(SHIFTED, 0.05), (rotation_z(0.02), 0.05), (np.eye(4), 0.0511)],
    ids=["way", "turn", "fingers"],
)
def test_the_watch_sees_what_moves_after_a_stop_and_only_then(after):
    watch = Watch()
    before = np.eye(4), 0.05
    watch.look(*after, 0.0, by_hand=False)
    watch.stopped("a pause", 1.0)
    watch.look(*after, 1.1, by_hand=False)  # it still brakes
    watch.look(*before, 1.0 + BRAKE_s, by_hand=False)
    watch.look(*after, 2.0, by_hand=True)
    watch.look(*before, 2.1, by_hand=False)
    assert not watch.violations
    watch.look(*after, 2.2, by_hand=False)
    assert len(watch.violations) == 1 and "a pause" in watch.violations[0]
    watch.wished()
    watch.look(*before, 2.3, by_hand=False)
    assert len(watch.violations) == 1
