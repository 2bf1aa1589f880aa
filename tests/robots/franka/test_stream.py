"""The 100 Hz stream on a fake arm: ramps, tilt, faults of a fake, and that every thread ends.

``test_checks.py`` attacks the same stream with random states and actions, ``test_stops.py`` with
whole sessions.
"""

import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from robot_fakes import START, refused

from uniforce_robots.franka.poses import ToolPose
from uniforce_robots.franka.stream import ArmStream, Ramp, StreamSettings
from uniforce_vtla.errors import RobotError
from uniforce_vtla.hand import Hand


@pytest.fixture
def started(arm, patient):
    """Return a function that starts a stream with changed settings; it is stopped at the end."""
    with ExitStack() as ending:

        def start(hand=None, **changes):
            stream = ArmStream(arm, replace(patient, **changes), hand=hand)
            stream.start()
            ending.callback(stream.stop)
            return stream

        yield start
    assert not [t for t in threading.enumerate() if t.name == "arm-stream"]


@pytest.fixture
def stream(started):
    return started()


def away(dz, yaw=0.0):
    return ToolPose(START.position_m + np.array([0, 0, dz]), yaw)


def test_a_ramp_is_straight_and_rests_at_both_ends():
    ramp = Ramp(START, away(-0.01, 0.2), 10.0, 0.04)
    z = [ramp.at(t).position_m[2] for t in (9.0, 10.0, 10.01, 10.02, 10.04, 11.0)]
    assert z == pytest.approx([0.3, 0.3, 0.2975, 0.295, 0.29, 0.29], abs=1e-9)
    assert ramp.at(10.02).yaw_rad == pytest.approx(0.1)


def test_a_mistake_in_a_backend_lets_the_arm_go_too(arm, stream, eventually):
    arm.set_target = lambda pose: 1 / 0
    stream.submit(away(-0.01))
    eventually(lambda: arm.stops)
    with refused("other", match="ZeroDivisionError"):
        stream.submit(away(0.0))


@pytest.mark.parametrize("error", [ValueError("handle is closed"), BrokenPipeError()])
def test_a_hand_whose_pipe_is_closed_does_not_keep_the_arm_from_stopping(arm, error):
    hand = Mock(spec=Hand)
    hand.halt.side_effect = error
    stream = ArmStream(arm, hand=hand)
    stream._let_go()
    assert arm.stops and stream.fault.fault == "connection"


def test_late_commands_are_logged_once(arm, stream, eventually, caplog):
    arm.success_rate = 0.5
    arm.mode = "move"
    first = stream.state.time_s
    eventually(lambda: stream.state.time_s > first + 0.1)
    assert caplog.text.count("in time") == 1


def test_an_old_reading_is_not_given_out(arm):
    stream = ArmStream(arm, StreamSettings(state_age_s=0.05))
    stream.start()
    stream.stop()
    time.sleep(0.1)
    with refused("stale", match="younger"):
        _ = stream.state


def test_a_hold_the_watchdog_and_every_end_stop_the_hand_and_its_fault_ends_the_stream(
    arm, started, eventually
):
    hand = Mock(Hand)
    stream = started(hand, stale_s=0.2)
    stream.hold()
    assert hand.stop.call_count == 1
    stream.submit(away(-0.01))
    eventually(lambda: stream.stale_count == 1)
    assert hand.stop.call_count == 2 and not hand.halt.called
    hand.tick.side_effect = RobotError("the hand hangs", "hand_deadline")
    eventually(lambda: arm.stops)
    assert (hand.stop.call_count, hand.halt.call_count) == (2, 1)
    with pytest.raises(RobotError, match="the hand hangs"):
        stream.submit(away(0.0))


def tilted(pose, by_rad):
    return replace(pose, tilt_rad=np.array([0.6, 0.8, 0.0]) * by_rad).ee_to_base()


def test_a_tilted_hand_is_refused_at_the_start_and_in_motion(arm, stream, eventually):
    stream.submit(away(-0.01))
    eventually(lambda: arm.targets)
    arm.follows = False
    for by_rad in np.arange(0.0, 0.2, 0.04):
        arm.pose = tilted(START, by_rad)  # slowly: a fast one is a jump
        time.sleep(0.02)
    eventually(lambda: stream.fault is not None)
    assert stream.fault.fault == "tilt"
    with refused("tilt", match=r"within 9° of straight down, got 9°"):
        ArmStream(arm).read_first()


def test_staying_never_turns_a_hand_and_a_wished_way_levels_it(arm):
    now = [100.0]
    pose = tilted(START, 0.1)
    arm.pose = pose
    arm.follows = False
    stream = ArmStream(arm, StreamSettings(state_age_s=1.0, stale_s=1.0), clock=lambda: now[0])
    stream.read_first()
    wishes = [START] * 30 + [away(-0.0013 * step) for step in range(30)]
    for wish in wishes:
        stream.submit(wish)
        for _ in range(3):
            now[0] += 0.01
            stream.tick()
    tilts = [float(np.linalg.norm(ToolPose.from_ee(target).tilt_rad)) for target in arm.targets]
    assert tilts[:90] == pytest.approx([0.1] * 90), "a wish to stay"
    assert tilts[-1] == pytest.approx(0.1 - 0.0013 * 29, abs=2e-3), "1 rad along each metre"


def test_start_comes_first(arm):
    stream = ArmStream(arm)
    with pytest.raises(RobotError):
        stream.submit(START)
    with pytest.raises(RobotError):
        _ = stream.state
    stream.stop()
