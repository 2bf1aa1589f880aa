"""What no robot can report is named for what it is; what one does report passes."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from uniforce_robots.franka.arm import ArmState
from uniforce_robots.franka.state_check import StateCheck
from uniforce_vtla.errors import RobotError

START = ArmState(5.0, 5.0, np.zeros(7), np.zeros(7), np.eye(4) + np.diag([0.0] * 4), np.zeros(6), "move", 1.0)


def moved(state: ArmState, after_s: float, by_m: float = 0.0, **changes: Any) -> ArmState:
    pose = state.ee_to_base.copy()
    pose[0, 3] += by_m
    later = replace(state, time_s=state.time_s + after_s, robot_time_s=state.robot_time_s + after_s)
    return replace(later, **({"ee_to_base": pose, "q_rad": state.q_rad + 1e-9} | changes))


def fault(*states: ArmState) -> str:
    check = StateCheck()
    try:
        for state in states:
            check(state)
    except RobotError as error:
        return error.fault
    return ""


def with_number(array: np.ndarray, number: float) -> np.ndarray:
    changed = array.copy()
    changed.flat[-2] = number
    return changed


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["ee_to_base", "q_rad", "dq_rad_s"])
def test_no_numbers(name: str, number: float) -> None:
    assert fault(replace(START, **{name: with_number(getattr(START, name), number)})) == "bad_state"


def test_a_lost_force_estimate() -> None:
    assert fault(replace(START, wrench_N=with_number(START.wrench_N, np.nan))) == "force"


@pytest.mark.parametrize("z", [0.5, -1.0])
def test_a_pose_that_is_no_rotation(z: float) -> None:
    assert fault(replace(START, ee_to_base=np.diag([1.0, 1.0, z, 1.0]))) == "bad_state"


def test_a_clock_that_runs_backwards() -> None:
    assert fault(START, moved(START, -0.005)) == "bad_state"


@pytest.mark.parametrize("after_s", [0.001, 0.01, 0.5])
def test_a_jump_of_a_decimetre_is_one_after_any_pause(after_s: float) -> None:
    assert fault(START, moved(START, after_s, 0.1)) == "jump"
    assert fault(START, moved(START, after_s, q_rad=START.q_rad + 0.3)) == "jump"


def test_a_turn_of_the_hand_that_is_too_fast() -> None:
    c, s = np.cos(0.3), np.sin(0.3)
    pose = np.eye(4)
    pose[:2, :2] = [[c, -s], [s, c]]
    assert fault(START, moved(START, 0.01, ee_to_base=pose)) == "jump"


def test_a_joint_faster_than_its_data_sheet() -> None:
    assert fault(START, moved(START, 0.01, dq_rad_s=np.full(7, 4.0))) == "speed"
    assert fault(replace(START, dq_rad_s=np.full(7, 4.0))) == "speed", "also in the first reading"


def test_an_arm_at_full_speed_and_one_that_rests_pass() -> None:
    fast = [START]
    for _ in range(100):
        fast.append(moved(fast[-1], 0.01, 0.017, dq_rad_s=np.full(7, 2.0), q_rad=fast[-1].q_rad + 0.02))
    assert fault(*fast) == ""
    assert fault(*[START] * 50) == "", "the same reading again is no jump"


def test_readings_that_do_not_change_while_the_target_moves() -> None:
    check, target, state = StateCheck(), np.zeros(3), START
    with pytest.raises(RobotError) as caught:
        for _ in range(30):
            check(state)
            target = target - np.array([0.0, 0.0, 0.001])
            check.follows(target)
            state = moved(state, 0.01, q_rad=START.q_rad)
    assert caught.value.fault == "frozen"


def test_a_blocked_arm_whose_encoders_are_alive_passes() -> None:
    check, target, state = StateCheck(), np.zeros(3), START
    for _ in range(60):
        check(state)
        target = target - np.array([0.0, 0.0, 0.001])
        check.follows(target)
        state = moved(state, 0.01)
