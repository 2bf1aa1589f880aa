"""Measures of the trials, on cases whose answer is known."""

import json
import math

import numpy as np
import pytest

from benchmarks.recorder.faults import summary
from benchmarks.recorder.rig import arm_clock, find_hold
from benchmarks.recorder.verdict import bars


def wire(stops_s):
    """An arm that goes round at 63 mm/s from second 0 and stops for good."""
    lines = []
    for time_s in np.arange(0, 3, 1e-3):
        angle = math.pi * min(time_s, stops_s)
        position = [0.3 + 0.02 * math.cos(angle), 0.02 * math.sin(angle), 0.4]
        number = round(500 * time_s)  # its clock runs at half the speed
        line = {"what": "state", "id": number, "time_s": float(time_s), "position_m": position}
        lines.append(line)
    return lines


def test_the_hold_is_when_the_arm_began_to_brake_for_good():
    hold = find_hold(wire(stops_s=1.4), fault_s=1.0)
    assert hold == {"hold_s": pytest.approx(0.4, abs=0.03), "rest_s": pytest.approx(0.4, abs=0.03)}
    assert find_hold(wire(stops_s=0.5), fault_s=1.0) == {"hold_s": 0.0, "rest_s": 0.0}
    assert arm_clock(wire(stops_s=0.5)) == pytest.approx(0.5, abs=0.01)


def test_braking_is_no_more_following():
    lines = wire(stops_s=1.4)
    end = np.array(lines[-1]["position_m"])
    slide = np.array([0, 0.006, 0])
    for line in lines:
        if line["time_s"] >= 1.4:  # slides on, 6 mm in all, as a soft spring lets it
            share = 1 - math.exp((1.4 - line["time_s"]) / 0.1)
            line["position_m"] = (end + slide * share).tolist()
    hold = find_hold(lines, fault_s=1.0)
    assert hold["hold_s"] < 0.5 and 0.55 < hold["rest_s"] < 0.65


def test_an_arm_that_goes_on_was_not_held():
    assert find_hold(wire(stops_s=9.0), fault_s=1.0) is None
    assert find_hold(wire(stops_s=2.9), fault_s=1.0) is None, "0.1 s of rest proves nothing"
    assert find_hold([], fault_s=1.0) is None


def test_verdicts():
    plain = {"right_outcome": True, "label": "aborted:x", "exit_code": 3}
    findings = [plain | {"hold_s": 0.1 * n} for n in range(10)]
    result = {
        "faults": {"camera_stops": summary(findings), "mute_at_connect": summary(findings[:2])},
        "runs": {"faults": {"judged": True}},
    }
    found = {bar["bar"]: bar["verdict"] for bar in bars(result)}
    assert found["camera_stops: right outcome"] == "met" and found["camera_stops: held"] == "missed"
    assert found["mute_at_connect: held"] == "not judged", "two trials are no ten"
    result["runs"]["faults"]["judged"] = False
    assert "missed" not in {bar["verdict"] for bar in bars(result)}
    json.dumps(result)
