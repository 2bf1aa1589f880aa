"""The 100 Hz stream on a fake arm: ramps, watchdog, faults, and that every thread ends."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import pytest
from robot_fakes import START, FakeArm

from lerobot_robot_uniforce_franka.poses import ToolPose
from lerobot_robot_uniforce_franka.stream import ArmStream, Ramp, StreamSettings
from uniforce_vtla.errors import RobotError

SLOW = StreamSettings(
    state_age_s=30.0, stale_s=30.0
)  # a test machine stalls longer than a robot's computer may


@pytest.fixture
def arm() -> FakeArm:
    return FakeArm()


@pytest.fixture
def stream(arm: FakeArm) -> Iterator[ArmStream]:
    stream = ArmStream(arm, SLOW)
    stream.start()
    yield stream
    stream.stop()
    assert not [t for t in threading.enumerate() if t.name == "arm-stream"]


def away(dz: float, yaw: float = 0.0) -> ToolPose:
    return ToolPose(START.position_m + np.array([0, 0, dz]), yaw)


def test_a_ramp_is_straight_and_rests_at_both_ends() -> None:
    ramp = Ramp(away(0.0), away(-0.01, 0.2), 10.0, 0.04)
    assert [
        round(float(ramp.at(t).position_m[2] - 0.3), 5) for t in (9.0, 10.0, 10.01, 10.02, 10.04, 11.0)
    ] == [
        0,
        0,
        -0.0025,
        -0.005,
        -0.01,
        -0.01,
    ]
    assert ramp.at(10.02).yaw_rad == pytest.approx(0.1)


def test_nothing_moves_before_the_first_action(arm: FakeArm, stream: ArmStream, eventually: Callable) -> None:
    first = stream.state.time_s
    eventually(lambda: stream.state.time_s > first + 0.05)
    assert not arm.targets


def test_an_action_is_reached_through_steps_between(arm: FakeArm, eventually: Callable) -> None:
    stream = ArmStream(arm, StreamSettings(action_period_s=0.5, stale_s=30.0, state_age_s=30.0))
    stream.start()
    stream.submit(away(-0.02))
    eventually(lambda: bool(arm.targets) and abs(arm.targets[-1][1][2, 3] - 0.28) < 1e-9)
    stream.stop()
    z = [pose[2, 3] for _, pose in arm.targets]
    assert all(a >= b for a, b in pairwise(z)), "never back"
    assert sum(0.2801 < value < 0.2999 for value in z) >= 2, "it did not jump"
    begun = arm.targets[0][0]
    for at, pose in arm.targets:
        assert abs(0.3 - pose[2, 3]) <= 0.04 * (at - begun) + 0.04 * 0.1, "no faster than the ramp"


def test_when_actions_stop_the_target_becomes_the_measured_pose_once(
    arm: FakeArm, eventually: Callable
) -> None:
    arm.follows = False  # it presses on something: measured stays above the target
    stream = ArmStream(arm, StreamSettings(stale_s=0.2, state_age_s=30.0))
    stream.start()
    stream.submit(away(-0.015))
    submitted = time.monotonic()
    eventually(lambda: stream.stale_count == 1)
    eventually(lambda: abs(arm.targets[-1][1][2, 3] - 0.3) < 1e-9)
    held = next(at for at, pose in arm.targets if at > submitted + 0.1 and abs(pose[2, 3] - 0.3) < 1e-9)
    assert held - submitted >= 0.2
    arm.pose[2, 3] = 0.25  # pushed down: the target must not follow
    count = len(arm.targets)
    eventually(lambda: len(arm.targets) > count + 5)
    assert arm.targets[-1][1][2, 3] == pytest.approx(0.3) and stream.stale_count == 1
    stream.submit(away(-0.06))
    eventually(lambda: abs(arm.targets[-1][1][2, 3] - 0.24) < 1e-9)
    stream.stop()


@pytest.mark.parametrize(
    "mode, fault", [("reflex", "reflex"), ("user_stopped", "user_stop"), ("guiding", "guiding")]
)
def test_a_stopped_arm_ends_the_stream_by_name(
    arm: FakeArm, stream: ArmStream, eventually: Callable, mode: str, fault: str
) -> None:
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


def test_a_lost_arm_is_let_go_within_half_a_second(
    arm: FakeArm, stream: ArmStream, eventually: Callable
) -> None:
    stream.submit(away(-0.01))
    begun = time.monotonic()
    arm.fault = RobotError("gone", "connection")
    eventually(lambda: bool(arm.stopped_at))
    assert stream.fault is arm.fault
    if arm.stopped_at[0] - begun > 0.5:  # say so instead of blaming the code for the machine
        pytest.skip(f"the machine took {arm.stopped_at[0] - begun:.2f} s for a loop of 10 ms")


def test_a_robot_that_tells_nothing_new_is_gone(arm: FakeArm, eventually: Callable) -> None:
    stream = ArmStream(arm, StreamSettings(stale_s=30.0, state_age_s=0.1))
    stream.start()
    stream.submit(away(-0.01))
    begun = arm.silent_since_s = time.monotonic()
    eventually(lambda: bool(arm.stopped_at))
    assert stream.fault is not None and stream.fault.fault == "connection"
    assert arm.stopped_at[0] - begun > 0.19, "not at once: a reading may repeat"
    stream.stop()


def test_holding_takes_the_measured_pose_at_once(
    arm: FakeArm, stream: ArmStream, eventually: Callable
) -> None:
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


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_mistake_in_a_backend_lets_the_arm_go_too(
    arm: FakeArm, stream: ArmStream, eventually: Callable
) -> None:
    arm.set_target = lambda pose: 1 / 0  # type: ignore[method-assign]
    stream.submit(away(-0.01))
    eventually(lambda: bool(arm.stopped_at))
    with pytest.raises(RobotError) as caught:
        stream.submit(away(0.0))
    assert caught.value.fault == "ended"


def test_late_commands_are_told_once(
    arm: FakeArm, stream: ArmStream, eventually: Callable, caplog: pytest.LogCaptureFixture
) -> None:
    arm.success_rate, arm.mode = 0.5, "move"
    first = stream.state.time_s
    eventually(lambda: stream.state.time_s > first + 0.1)
    assert sum("in time" in record.message for record in caplog.records) == 1


def test_after_the_end_nothing_is_taken(arm: FakeArm) -> None:
    stream = ArmStream(arm, SLOW)
    stream.start()
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
    import subprocess
    import sys
    from pathlib import Path

    program = tmp_path / "forgetful.py"
    program.write_text(
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from robot_fakes import FakeArm\n"
        "from lerobot_robot_uniforce_franka.stream import ArmStream\n"
        "arm = FakeArm(); stream = ArmStream(arm); stream.start()\n"
        "raise SystemExit(3)\n"
    )
    assert subprocess.run([sys.executable, str(program)], timeout=240).returncode == 3


def test_start_comes_first() -> None:
    stream = ArmStream(FakeArm())
    with pytest.raises(RobotError):
        stream.submit(ToolPose(np.zeros(3), 0.0))
    with pytest.raises(RobotError):
        _ = stream.state
    stream.stop()
