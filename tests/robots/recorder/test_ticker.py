"""The beat on a clock that the test sets."""

import pytest

from uniforce_robots.recorder.ticker import Ticker


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0
        self.slept: list[float] = []

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now_s += seconds


def ticker(paced: bool = True) -> tuple[Clock, Ticker]:
    clock = Clock()
    return clock, Ticker(10.0, paced, clock, clock.sleep)


def test_deadlines_are_absolute() -> None:
    clock, beat = ticker()
    for work_s in (0.03, 0.08, 0.0, 0.05):
        beat.wait()
        clock.now_s += work_s
    assert clock.slept == pytest.approx([0.07, 0.02, 0.1]), "the work before is made up for"
    assert beat.stats.mean_hz == pytest.approx(10.0)
    assert beat.stats.jitter_max_ms == pytest.approx(0, abs=1e-6)


def test_what_is_late_and_what_is_missed() -> None:
    clock, beat = ticker()
    assert beat.stats.late_share == beat.stats.mean_hz == 0
    beat.wait()
    clock.now_s += 0.13
    assert beat.wait() == pytest.approx(0.03)
    clock.now_s += 0.29
    assert beat.wait() == pytest.approx(0.22), "due at .2, now .42"
    stats = beat.stats
    assert (stats.ticks, stats.missed, stats.late_share) == (3, 2, 0.4)
    assert stats.jitter_max_ms == pytest.approx(220)
    assert beat.wait() == 0 and clock.now_s == pytest.approx(100.5), "back on the grid"


def test_a_pause_does_not_count() -> None:
    clock, beat = ticker()
    beat.wait()
    beat.wait()
    clock.now_s += 7.0
    beat.resume()
    beat.wait()
    assert beat.stats.mean_hz == pytest.approx(10.0) and beat.stats.missed == 0


def test_a_scene_does_not_wait() -> None:
    clock, beat = ticker(paced=False)
    for _ in range(3):
        beat.wait()
        clock.now_s += 1.0
    assert not clock.slept and beat.stats.missed == 0 and beat.stats.jitter_max_ms == 0
    assert beat.stats.as_dict()["mean_hz"] == 1.0
