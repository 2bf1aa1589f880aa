"""What the trials measure with, on cases whose answer is known."""

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.recorder.circle import Circle, CircleConfig
from benchmarks.recorder.end_to_end import lateness_ms, spans
from benchmarks.recorder.faults import summary
from benchmarks.recorder.ledger import Ledger
from benchmarks.recorder.session import Line
from benchmarks.recorder.small_disk import MB, SmallDisk
from benchmarks.recorder.stillness import arm_clock, find_hold
from benchmarks.recorder.verdict import bars
from uniforce_robots.recorder.disk_guard import free_bytes
from uniforce_robots.recorder.ticker import Ticker


def wire(stops_s: float, until_s: float = 3.0) -> list[dict]:
    """An arm that goes round at 63 mm/s from second 0 and stops for good."""
    lines = []
    for time_s in np.arange(0, until_s, 1e-3):
        angle = math.pi * min(time_s, stops_s)
        position = [0.3 + 0.02 * math.cos(angle), 0.02 * math.sin(angle), 0.4]
        number = round(500 * time_s)  # its clock runs at half the speed
        lines.append({"what": "state", "id": number, "time_s": float(time_s), "position_m": position})
    return lines


def test_the_hold_is_when_the_arm_began_to_brake_for_good() -> None:
    hold = find_hold(wire(stops_s=1.4), fault_s=1.0)
    assert hold == {"hold_s": pytest.approx(0.4, abs=0.03), "rest_s": pytest.approx(0.4, abs=0.03)}
    assert find_hold(wire(stops_s=0.5), fault_s=1.0) == {"hold_s": 0.0, "rest_s": 0.0}
    assert arm_clock(wire(stops_s=0.5)) == pytest.approx(0.5, abs=0.01)


def test_braking_is_no_more_following() -> None:
    lines = wire(stops_s=1.4)
    end, slide = np.array(lines[-1]["position_m"]), np.array([0, 0.006, 0])
    for line in lines:
        if line["time_s"] >= 1.4:  # slides on, 6 mm in all, as a soft spring lets it
            line["position_m"] = (end + slide * (1 - math.exp((1.4 - line["time_s"]) / 0.1))).tolist()
    hold = find_hold(lines, fault_s=1.0)
    assert hold is not None and hold["hold_s"] < 0.5 and 0.55 < hold["rest_s"] < 0.65


def test_an_arm_that_goes_on_was_not_held() -> None:
    assert find_hold(wire(stops_s=9.0), fault_s=1.0) is None
    assert find_hold(wire(stops_s=2.9), fault_s=1.0) is None, "0.1 s of rest proves nothing"
    assert find_hold([], fault_s=1.0) is None


def test_stored_times_show_what_the_ticker_counted() -> None:
    now_s, busy = [0.0], iter([0.0, 0.0, 0.004, 0.05, 0.08, 0.0, 0.0, 0.0])
    sleep = lambda seconds: now_s.__setitem__(0, now_s[0] + seconds)  # noqa: E731
    ticker = Ticker(30, clock=lambda: now_s[0], sleep=sleep)
    tick_s = []
    for took_s in busy:
        ticker.wait()
        tick_s.append(now_s[0])
        now_s[0] += took_s
    late_ms, missed = lateness_ms(np.array(tick_s), 30)
    assert missed == ticker.stats.missed == 1
    assert np.percentile(late_ms, 99) == pytest.approx(ticker.stats.jitter_p99_ms, abs=0.01)


def test_episodes_are_found_in_what_was_said() -> None:
    said = ["up to 8 MB", "episode 1/2: go", "stored success", "episode 2/2 is next: open", "episode 2/2: go"]
    assert spans([Line(float(n), text) for n, text in enumerate(said)], 1.5) == [(1.0, 2.5), (4.0, 5.5)]


def test_a_circle_stays_near_home_wherever_it_is_begun_again() -> None:
    circle, home = Circle(CircleConfig(id="test")), {"x.pos": 0.3, "y.pos": 0.0, "z.pos": 0.4, "yaw.pos": 0.0}
    here, rng = {**home, "width.pos": 0.08}, np.random.default_rng(0)
    circle.connect()
    for _ in range(50):
        circle.start_from(here)
        points = [circle.get_action() for _ in range(int(rng.integers(5, 90)))]
        places = [(point["x.pos"], point["y.pos"]) for point in (here, *points)]
        steps = [math.dist(a, b) for a, b in itertools.pairwise(places)]
        assert max(steps) == pytest.approx(min(steps)), "a steady speed, the first step included"
        assert all(math.dist(place, (0.3, 0.0)) < 0.0401 for place in places)
        here = points[-1]


def test_half_a_line_is_no_finding(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path)
    ledger.add("kill9", {"n": 1})
    with (tmp_path / "kill9.jsonl").open("a") as file:
        file.write('{"n": 2')
    assert ledger.read("kill9") == [{"n": 1}] and ledger.read("other") == []


def test_a_small_disk_gets_full_and_empty_again(tmp_path: Path) -> None:
    root = tmp_path / "disk"
    with SmallDisk(root, 40) as disk:
        limit_MB = disk.reserve_MB(10)
        assert free_bytes(root) / MB > limit_MB
        disk.fill(5, 10)
        assert free_bytes(root) / MB < limit_MB
    assert not root.is_mount() and not list(root.iterdir())


def test_verdicts() -> None:
    plain = {"right_outcome": True, "label": "aborted:x", "exit_code": 3}
    findings = [plain | {"hold_s": 0.1 * n} for n in range(10)]
    result = {
        "faults": {"camera_stops": summary(findings), "mute_at_connect": summary(findings[:2])},
        "runs": {"faults": {"judged": True}},
    }
    found = {bar["bar"]: bar["verdict"] for bar in bars(result)}
    assert found["camera_stops: right outcome"] == "met" and found["camera_stops: held"] == "missed"
    assert found["mute_at_connect: held"] == "not judged", "two trials are no ten"
    assert "missed" not in {bar["verdict"] for bar in bars(result | {"runs": {"faults": {"judged": False}}})}
    json.dumps(result)
