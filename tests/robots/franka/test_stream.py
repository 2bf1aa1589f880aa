"""The 100 Hz stream on a fake arm: ramps, watchdog, faults, and that every thread ends."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from robot_fakes import START, FakeArm

from uniforce_robots.franka.hand import Hand
from uniforce_robots.franka.poses import ToolPose
from uniforce_robots.franka.stream import ArmStream, Ramp, StreamSettings
from uniforce_vtla.errors import RobotError


@pytest.fixture
def started(arm: FakeArm, patient: StreamSettings) -> Iterator[Callable[..., ArmStream]]:
    """Return a function that starts a stream with changed settings; it is stopped at the end."""
    with ExitStack() as ending:

        def start(hand: Hand | None = None, **changes: float) -> ArmStream:
            stream = ArmStream(arm, replace(patient, **changes), hand=hand)
            stream.start()
            ending.callback(stream.stop)
            return stream

        yield start
    assert not [t for t in threading.enumerate() if t.name == "arm-stream"]


@pytest.fixture
def stream(started: Callable[..., ArmStream]) -> ArmStream:
    return started()


def away(dz: float, yaw: float = 0.0) -> ToolPose:
    return ToolPose(START.position_m + np.array([0, 0, dz]), yaw)


def test_a_ramp_is_straight_and_rests_at_both_ends() -> None:
    ramp = Ramp(away(0.0), away(-0.01, 0.2), 10.0, 0.04)
    z = [round(float(ramp.at(t).position_m[2] - 0.3), 5) for t in (9.0, 10.0, 10.01, 10.02, 10.04, 11.0)]
    assert z == [0, 0, -0.0025, -0.005, -0.01, -0.01]
    assert ramp.at(10.02).yaw_rad == pytest.approx(0.1)


def test_nothing_moves_before_the_first_action(arm: FakeArm, stream: ArmStream, eventually: Callable) -> None:
    first = stream.state.time_s
    eventually(lambda: stream.state.time_s > first + 0.05)
    assert not arm.targets


def test_an_action_is_reached_through_steps_between(arm: FakeArm, started: Callable, eventually: Callable):
    stream = started(action_period_s=0.2)
    stream.submit(away(-0.02))
    eventually(lambda: bool(arm.targets) and abs(arm.targets[-1][1][2, 3] - 0.28) < 1e-9)
    stream.stop()
    z = [pose[2, 3] for _, pose in arm.targets]
    assert all(a >= b for a, b in pairwise(z)), "never back"
    assert sum(0.2801 < value < 0.2999 for value in z) >= 2, "it did not jump"
    begun = arm.targets[0][0]
    for at, pose in arm.targets:
        assert abs(0.3 - pose[2, 3]) <= 0.1 * (at - begun) + 0.1 * 0.1, "no faster than the ramp"


def test_when_actions_stop_the_target_becomes_the_measured_pose_once(arm, started, eventually) -> None:
    arm.follows = False  # it presses on something: measured stays above the target
    stream = started(stale_s=0.2)
    stream.submit(away(-0.015))
    submitted = time.monotonic()
    eventually(lambda: stream.stale_count == 1)
    eventually(lambda: abs(arm.targets[-1][1][2, 3] - 0.3) < 1e-9)
    held = next(at for at, pose in arm.targets if at > submitted + 0.1 and abs(pose[2, 3] - 0.3) < 1e-9)
    assert held - submitted >= 0.2
    arm.pose[2, 3] = 0.296  # pushed down: the target must not follow
    count = len(arm.targets)
    eventually(lambda: len(arm.targets) > count + 5)
    assert arm.targets[-1][1][2, 3] == pytest.approx(0.3) and stream.stale_count == 1
    stream.submit(away(-0.02))
    eventually(lambda: abs(arm.targets[-1][1][2, 3] - 0.28) < 1e-9)


@pytest.mark.parametrize("mode, fault", [("reflex", "reflex"), ("user_stopped", "user_stop"), ("guiding", "guiding")])
def test_a_stopped_arm_ends_the_stream_by_name(arm, stream, eventually, mode, fault) -> None:
    stream.submit(away(-0.01))
    arm.mode = mode
    eventually(lambda: stream.fault is not None)
    eventually(lambda: bool(arm.stopped_at))
    count = len(arm.targets)
    for use in (lambda: stream.submit(away(0.0)), lambda: stream.state):
        with pytest.raises(RobotError) as caught:
            use()
        assert caught.value.fault == fault
    time.sleep(0.05)
    assert len(arm.targets) == count, "no target after the fault"


def test_a_lost_arm_is_let_go_within_a_tick(arm: FakeArm, stream: ArmStream, eventually: Callable) -> None:
    stream.submit(away(-0.01))
    arm.fault = RobotError("gone", "connection")
    eventually(lambda: bool(arm.stopped_at))
    assert stream.fault is arm.fault
    assert arm.refusals <= 2, "a tick in which it was lost, and one look for a better reason"


def test_a_robot_that_says_nothing_new_is_gone(arm: FakeArm, started: Callable, eventually: Callable) -> None:
    stream = started(state_age_s=0.2)
    stream.submit(away(-0.01))
    begun = arm.silent_since_s = time.monotonic()
    eventually(lambda: bool(arm.stopped_at))
    assert arm.stopped_at[0] - begun > 0.19, "not at once: a reading may repeat"
    with pytest.raises(RobotError, match="new states") as caught:
        _ = stream.state
    assert caught.value.fault == "connection"


def test_holding_takes_the_measured_pose_at_once(arm: FakeArm, stream: ArmStream, eventually: Callable):
    stream.hold()
    assert not arm.targets, "nothing to hold before the first action"
    arm.follows = False
    stream.submit(away(-0.01))
    eventually(lambda: bool(arm.targets))
    stream.hold()
    count = len(arm.targets)
    eventually(lambda: len(arm.targets) > count + 2)
    np.testing.assert_allclose(arm.targets[-1][1], arm.pose, atol=1e-9)
    assert stream.stale_count == 0


def test_a_mistake_in_a_backend_lets_the_arm_go_too(arm: FakeArm, stream: ArmStream, eventually: Callable):
    arm.set_target = lambda pose: 1 / 0  # type: ignore[method-assign]
    stream.submit(away(-0.01))
    eventually(lambda: bool(arm.stopped_at))
    with pytest.raises(RobotError) as caught:
        stream.submit(away(0.0))
    assert caught.value.fault == "other" and "ZeroDivisionError" in str(caught.value)


def test_late_commands_are_logged_once(arm, stream, eventually, caplog) -> None:
    arm.success_rate, arm.mode = 0.5, "move"
    first = stream.state.time_s
    eventually(lambda: stream.state.time_s > first + 0.1)
    assert sum("in time" in record.message for record in caplog.records) == 1


def test_after_the_end_nothing_is_taken(arm: FakeArm, stream: ArmStream) -> None:
    stream.stop()
    stream.stop()
    assert arm.stopped_at
    with pytest.raises(RobotError) as caught:
        stream.submit(away(0.0))
    assert caught.value.fault == "ended" and not arm.targets


def test_an_old_reading_is_not_given_out(arm: FakeArm) -> None:
    stream = ArmStream(arm, StreamSettings(state_age_s=0.05))
    stream.start()
    stream.stop()
    time.sleep(0.1)
    with pytest.raises(RobotError, match="younger") as caught:
        _ = stream.state
    assert caught.value.fault == "stale"


@pytest.mark.slow
def test_a_program_that_forgets_to_disconnect_still_ends(tmp_path) -> None:
    program = tmp_path / "forgetful.py"
    program.write_text(
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from robot_fakes import FakeArm\n"
        "from uniforce_robots.franka.stream import ArmStream\n"
        "arm = FakeArm(); stream = ArmStream(arm); stream.start()\n"
        "raise SystemExit(3)\n"
    )
    assert subprocess.run([sys.executable, str(program)], timeout=240).returncode == 3


@pytest.mark.parametrize("fault", ["bad_state", "force", "jump"])
def test_a_reading_that_cannot_be_ends_the_stream_by_name(arm, stream, eventually, fault) -> None:
    stream.submit(away(-0.01))
    eventually(lambda: bool(arm.targets))
    pose = arm.pose.copy()
    if fault == "force":
        arm.wrench_N = np.full(6, np.nan)
    else:
        pose[0, 3] = np.nan if fault == "bad_state" else pose[0, 3] + 0.1
        arm.follows, arm.pose = False, pose
    eventually(lambda: bool(arm.stopped_at))
    assert stream.fault is not None and stream.fault.fault == fault
    assert all(np.isfinite(target).all() for _, target in arm.targets)


class WatchedHand(Hand):
    def __init__(self) -> None:
        self.hangs = False
        self.stops: list[str] = []

    def tick(self) -> None:
        if self.hangs:
            raise RobotError("the hand hangs", "hand_deadline")

    def stop(self) -> None:
        self.stops.append("stop")

    def halt(self) -> None:
        self.stops.append("halt")


def test_a_hand_at_fault_ends_the_stream_and_every_end_stops_the_hand(arm, started, eventually):
    hand = WatchedHand()
    stream = started(hand)
    stream.submit(away(-0.01))
    hand.hangs = True
    eventually(lambda: bool(arm.stopped_at))
    assert hand.stops == ["halt"]
    with pytest.raises(RobotError, match="the hand hangs"):
        stream.submit(away(0.0))


def test_a_hold_and_the_watchdog_stop_the_hand(started, eventually):
    hand = WatchedHand()
    stream = started(hand, stale_s=0.2)
    stream.hold()
    assert hand.stops == ["stop"]
    stream.submit(away(-0.01))
    eventually(lambda: stream.stale_count == 1)
    assert hand.stops == ["stop"] * 2


def tilted(pose: ToolPose, by_rad: float) -> np.ndarray:
    return replace(pose, tilt_rad=np.array([0.6, 0.8, 0.0]) * by_rad).ee_to_base()


def test_a_tilted_hand_is_refused_at_the_start_and_in_motion(arm: FakeArm, stream: ArmStream, eventually: Callable):
    stream.submit(away(-0.01))
    eventually(lambda: bool(arm.targets))
    arm.follows = False
    for by_rad in np.arange(0.0, 0.2, 0.04):
        arm.pose = tilted(START, by_rad)  # slowly: a fast one is a jump
        time.sleep(0.02)
    eventually(lambda: stream.fault is not None)
    assert stream.fault is not None and stream.fault.fault == "tilt"
    with pytest.raises(RobotError, match=r"within 9° of straight down, got 9°") as caught:
        ArmStream(arm).read_first()
    assert caught.value.fault == "tilt"


def test_staying_never_turns_a_hand_and_a_wished_way_levels_it(arm: FakeArm) -> None:
    now, pose = [100.0], tilted(START, 0.1)
    arm.pose, arm.follows = pose, False
    stream = ArmStream(arm, StreamSettings(state_age_s=1.0, stale_s=1.0), clock=lambda: now[0])
    stream.read_first()
    wishes = [START] * 30 + [away(-0.0013 * step) for step in range(30)]
    for wish in wishes:
        stream.submit(wish)
        for _ in range(3):
            now[0] += 0.01
            stream.tick()
    tilts = [float(np.linalg.norm(ToolPose.from_ee(target).tilt_rad)) for _, target in arm.targets]
    assert tilts[:90] == pytest.approx([0.1] * 90), "a wish to stay"
    assert tilts[-1] == pytest.approx(0.1 - 0.0013 * 29, abs=2e-3), "1 rad along each metre"


def test_halting_does_not_wait_for_a_client_that_blocks(arm: FakeArm, stream: ArmStream) -> None:
    arm.blocks_s = 0.5
    time.sleep(0.1)
    begun = time.monotonic()
    stream.halt(RobotError("no", "action"))
    with pytest.raises(RobotError, match="no"):
        stream.submit(away(0.0))
    assert time.monotonic() - begun < 0.3
    arm.blocks_s = 0.0


def test_the_speed_limit_holds_also_for_a_far_target_and_a_late_thread(arm: FakeArm) -> None:
    now = [100.0]
    arm.follows = False
    stream = ArmStream(arm, StreamSettings(state_age_s=1.0, stale_s=1.0), clock=lambda: now[0])
    stream.read_first()
    stream.submit(away(-0.045))
    for wait_s in (0.0, 0.01, 0.01, 0.5, 0.01, 0.01):
        now[0] += wait_s
        stream.tick()
    z = [pose[2, 3] for _, pose in arm.targets]
    steps = [a - b for a, b in pairwise(z)]
    assert steps == pytest.approx([0.0025, 0.0025, 0.025, 0.0025, 0.0025], abs=1e-9), "0.25 m/s, 0.1 s at most"


def test_start_comes_first() -> None:
    stream = ArmStream(FakeArm())
    with pytest.raises(RobotError):
        stream.submit(ToolPose(np.zeros(3), 0.0))
    with pytest.raises(RobotError):
        _ = stream.state
    stream.stop()
