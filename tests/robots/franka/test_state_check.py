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


C, S = np.cos(0.3), np.sin(0.3)
TURNED = np.array([[C, -S, 0, 0], [S, C, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
FAST = np.full(7, 4.0)
WRONG = [  # readings in order, and the fault of the last one
    *(
        ([replace(START, **{name: with_number(getattr(START, name), number)})], "bad_state")
        for name in ("ee_to_base", "q_rad", "dq_rad_s")
        for number in (np.nan, np.inf, -np.inf)
    ),
    ([replace(START, wrench_N=with_number(START.wrench_N, np.nan))], "force"),
    *(([replace(START, ee_to_base=np.diag([1.0, 1.0, z, 1.0]))], "bad_state") for z in (0.5, -1.0)),
    ([START, moved(START, -0.005)], "bad_state"),  # a clock that runs backwards
    *(([START, moved(START, after_s, 0.1)], "jump") for after_s in (0.001, 0.01, 0.5)),
    *(([START, moved(START, after_s, q_rad=START.q_rad + 0.3)], "jump") for after_s in (0.001, 0.01, 0.5)),
    ([START, moved(START, 0.01, ee_to_base=TURNED)], "jump"),
    ([START, moved(START, 0.01, dq_rad_s=FAST)], "speed"),
    ([replace(START, dq_rad_s=FAST)], "speed"),  # also in the first reading
]


@pytest.mark.parametrize("states, named", WRONG)
def test_what_no_robot_can_report(states: list[ArmState], named: str) -> None:
    assert fault(*states) == named


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
