"""Impossible readings are named; the last check of a pose, alone and under the whole chain."""

import logging
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from robot_fakes import refused

from benchmarks.trust.guard_cases import drive
from benchmarks.trust.guard_oracle import axes_of, pose_of, wrong_pose
from benchmarks.trust.mutations import notice
from uniforce_robots.fr3 import HAND_TO_FLANGE, HOME_q_rad, posture, rotation_z
from uniforce_robots.franka.arm import HAND_GUIDED, ArmState
from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.franka.poses import ToolPose, between, shortest_turn
from uniforce_robots.franka.state_check import SendCheck, StateCheck

LIMITS = GuardLimits()


def pose(x=0.0, turn=0.0, tilt=(0.0, 0.0, 0.0)):
    return ToolPose(np.array([0.45 + x, 0.0, 0.30]), turn, np.array(tilt))


SENT = [(0.0, pose()), (0.01, pose(0.002))]
REFUSED = {
    "nan": (0.02, pose(np.nan), pose()),
    "too fast": (0.02, pose(0.01), pose()),
    "turns too fast": (0.02, pose(0.002, 0.1), pose()),
    "clock stands still": (0.01, pose(0.004), pose()),
    "a pause buys no jump": (9.0, pose(0.04), pose()),
    "far from the arm": (0.02, pose(0.002), pose(0.2)),
    "turned from the arm": (0.02, pose(0.002), pose(turn=1.2)),
    "tilts too fast": (0.02, pose(0.002, tilt=(0.1, 0, 0)), pose()),
    "tilted too far": (9.0, pose(0.002, tilt=(0, 0.16, 0)), pose()),
}
# the judge of the chain sees no tilted pose at all
PLAIN = [name for name in REFUSED if "tilt" not in name]


@pytest.mark.parametrize("name", REFUSED)
def test_what_must_not_be_sent(name):
    check = SendCheck(LIMITS)
    for now_s, target in SENT:
        check(target, pose(), now_s)
    now_s, target, measured = REFUSED[name]
    with refused("guard"):
        check(target, measured, now_s)


def axes(pose):
    return np.array([*pose.position_m, pose.yaw_rad])


@pytest.mark.parametrize("name", PLAIN)
def test_the_judge_of_the_chain_sees_what_is_wrong(name):
    (first_s, first), (now_s, second) = SENT
    assert wrong_pose(LIMITS, axes(second), axes(pose()), axes(first), now_s - first_s) == []
    later_s, target, measured = REFUSED[name]
    assert wrong_pose(LIMITS, axes(target), axes(measured), axes(second), later_s - now_s)


def test_the_judge_reads_poses_by_itself():
    target = ToolPose(np.array([0.4, -0.1, 0.2]), 0.7)
    np.testing.assert_allclose(pose_of(axes(target)), target.ee_to_base(), atol=1e-12)
    np.testing.assert_allclose(axes_of(target.ee_to_base()), axes(target), atol=1e-12)


@pytest.mark.thorough
def test_a_broken_guard_is_noticed_on_the_copy_that_was_broken():
    """In a process of its own, as in ``benchmarks.trust.mutations``: not this process's copy."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(notice, "sent: box unchecked").result().startswith("box")


@pytest.mark.parametrize(
    "episodes, sent",
    [pytest.param(200, 18_000), pytest.param(1100, 100_000, marks=pytest.mark.thorough)],
)
def test_whatever_comes_nothing_wrong_is_sent(caplog, episodes, sent):
    """``python -m benchmarks.trust.mutations`` shows that each broken guard fails in 200
    episodes."""
    with caplog.at_level(logging.CRITICAL):
        found = drive(episodes=episodes, seed=7)
    assert found["violations"] == [] and found["sent"] > sent
    assert {"action", "bad_state", "jump", "speed", "force", "guard"} <= set(found["faults"]), (
        "it did attack"
    )


@pytest.mark.parametrize("yaw", [-3.0, -1.0, 0.0, 0.7, 3.1])
@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (-0.3, 1.2, 0.0)])
def test_a_pose_comes_back(yaw, tilt):
    pose = ToolPose(np.array([0.4, -0.1, 0.2]), yaw, np.array(tilt))
    again = ToolPose.from_ee(pose.ee_to_base())
    np.testing.assert_allclose(again.position_m, pose.position_m)
    np.testing.assert_allclose(again.tilt_rad, tilt, atol=1e-12)
    assert again.yaw_rad == pytest.approx(yaw)


def test_yaw_of_the_arms_home_is_a_quarter_turn_and_zero_lies_within_joint_7():
    home = posture(HOME_q_rad).flange_to_base @ HAND_TO_FLANGE
    assert ToolPose.from_ee(home).yaw_rad == pytest.approx(-np.pi / 2)
    q = HOME_q_rad - np.array([0, 0, 0, 0, 0, 0, np.pi / 2])
    assert ToolPose.from_ee(posture(q).flange_to_base @ HAND_TO_FLANGE).yaw_rad == pytest.approx(
        0, abs=1e-9
    )


def test_turns_take_the_shorter_way():
    assert shortest_turn(3.0, -3.0) == pytest.approx(2 * np.pi - 6)
    assert shortest_turn(0.1, 0.4) == pytest.approx(0.3)
    half = between(ToolPose(np.zeros(3), 3.1), ToolPose(np.ones(3), -3.1), 0.5)
    assert abs(half.yaw_rad) == pytest.approx(np.pi) and half.position_m[0] == 0.5


@pytest.mark.parametrize("yaw", [0.0, 0.6, np.pi / 2])
def test_the_closing_axis_is_the_stiff_one_however_the_hand_is_turned(yaw):
    R = ToolPose(np.zeros(3), yaw).ee_to_base()[:3, :3]
    K = HAND_GUIDED.matrix_in_base(R)
    np.testing.assert_allclose(R.T @ K[:3, :3] @ R, np.diag([200, 2000, 200]), atol=1e-9)
    assert not K[:3, 3:].any()


START = ArmState(5.0, 5.0, np.zeros(7), np.zeros(7), np.eye(4), np.zeros(6), "move", 1.0)


def moved(state, after_s, by_m=0.0, **changes):
    pose = state.ee_to_base.copy()
    pose[0, 3] += by_m
    later = replace(state, time_s=state.time_s + after_s, robot_time_s=state.robot_time_s + after_s)
    return replace(later, **({"ee_to_base": pose, "q_rad": state.q_rad + 1e-9} | changes))


JUMPS = {"by_m": 0.1}, {"q_rad": START.q_rad + 0.3}, {"ee_to_base": rotation_z(0.3)}
# readings in order, and the fault of the last one; the attack on the chain tries what else there is
WRONG = [
    ([replace(START, ee_to_base=np.diag([1.0, 1.0, 0.5, 1.0]))], "bad_state"),
    ([replace(START, dq_rad_s=np.full(7, 4.0))], "speed"),  # also in the first reading
    *(
        ([START, moved(START, after_s, **jump)], "jump")
        for after_s in (0.001, 0.01, 0.5)
        for jump in JUMPS
    ),
]


@pytest.mark.parametrize("states, named", WRONG)
def test_what_no_robot_can_report(states, named):
    check = StateCheck()
    *before, last = states
    for state in before:
        check(state)
    with refused(named):
        check(last)


def test_an_arm_at_full_speed_and_one_that_rests_pass():
    check = StateCheck()
    state = START
    for _ in range(100):
        check(state)
        turned_rad = state.q_rad + 0.02
        state = moved(state, 0.01, 0.017, dq_rad_s=np.full(7, 2.0), q_rad=turned_rad)
    for _ in range(50):
        check(state)  # the same reading again is no jump


@pytest.mark.parametrize("step_rad", [0.0, 1e-9])  # a blocked arm's encoders change by a bit
def test_readings_that_do_not_change_while_the_target_moves(step_rad):
    check = StateCheck()
    target = np.zeros(3)
    state = START
    with nullcontext() if step_rad else refused("frozen"):
        for _ in range(60):
            check(state)
            target = target - np.array([0.0, 0.0, 0.001])
            check.follows(target)
            state = moved(state, 0.01, q_rad=state.q_rad + step_rad)
