"""The last check before a pose is sent, alone and under the whole chain."""

import logging
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from benchmarks.trust.guard_cases import drive
from benchmarks.trust.guard_oracle import axes_of, pose_of, wrong_pose
from benchmarks.trust.mutations import notice
from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.franka.poses import ToolPose
from uniforce_robots.franka.send_check import SendCheck
from uniforce_vtla.errors import RobotError

LIMITS = GuardLimits()
HERE = np.array([0.45, 0.0, 0.30, 0.0])


def pose(*step: float) -> ToolPose:
    axes = HERE + np.array([*step, *[0.0] * (4 - len(step))])
    return ToolPose(axes[:3], float(axes[3]))


SENT = [(0.0, pose()), (0.01, pose(0.002))]
REFUSED = {
    "nan": (0.02, pose(np.nan), pose()),
    "too fast": (0.02, pose(0.01), pose()),
    "turns too fast": (0.02, pose(0.002, 0, 0, 0.1), pose()),
    "clock stands still": (0.01, pose(0.004), pose()),
    "a pause buys no jump": (9.0, pose(0.04), pose()),
    "far from the arm": (0.02, pose(0.002), pose(0.2)),
    "turned from the arm": (0.02, pose(0.002), pose(0, 0, 0, 1.2)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_must_not_be_sent(name: str) -> None:
    check = SendCheck(LIMITS)
    for now_s, target in SENT:
        check(target, pose(), now_s)
    now_s, target, measured = REFUSED[name]
    with pytest.raises(RobotError) as caught:
        check(target, measured, now_s)
    assert caught.value.fault == "guard"


def test_out_of_the_box_only_inwards() -> None:
    low = GuardLimits(low=(0.46, -0.3, 0.005, -1.5, 0.0))
    SendCheck(low)(pose(0.001), pose(), 0.0)
    with pytest.raises(RobotError, match="box"):
        SendCheck(low)(pose(-0.001), pose(), 0.0)


def test_letting_go_is_allowed_from_any_distance() -> None:
    check = SendCheck(LIMITS)
    check(pose(), pose(), 0.0)
    check(pose(0, 0, -0.02), pose(0, 0, -0.001), 0.1)
    check(pose(0, 0, -0.001), pose(0, 0, -0.001), 0.11)


def axes(pose: ToolPose) -> np.ndarray:
    return np.array([*pose.position_m, pose.yaw_rad])


@pytest.mark.parametrize("name", REFUSED)
def test_the_judge_of_the_chain_sees_what_is_wrong(name: str) -> None:
    (first_s, first), (now_s, second) = SENT
    assert wrong_pose(LIMITS, axes(second), HERE, axes(first), now_s - first_s) == []
    later_s, target, measured = REFUSED[name]
    assert wrong_pose(LIMITS, axes(target), axes(measured), axes(second), later_s - now_s)


def test_the_judge_reads_poses_by_itself() -> None:
    target = ToolPose(np.array([0.4, -0.1, 0.2]), 0.7)
    np.testing.assert_allclose(pose_of(axes(target)), target.ee_to_base(), atol=1e-12)
    np.testing.assert_allclose(axes_of(target.ee_to_base()), axes(target), atol=1e-12)


def test_a_broken_guard_is_noticed_on_the_copy_that_was_broken() -> None:
    """In a process of its own, as ``benchmarks.trust.mutations`` tries them: the copy must not be this process's."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(notice, "sent: box unchecked").result().startswith("box")


@pytest.mark.slow
def test_whatever_comes_nothing_wrong_is_sent(caplog: pytest.LogCaptureFixture) -> None:
    """``python -m benchmarks.trust.mutations`` shows that each broken guard fails this."""
    with caplog.at_level(logging.CRITICAL):
        found = drive(episodes=1100, seed=7)
    assert found["violations"] == [] and found["sent"] > 100_000
    assert {"action", "bad_state", "jump", "speed", "force", "guard"} <= set(found["faults"]), "it did attack"
