"""What the real arm refuses in a command, and that a command at the limit is followed."""

from __future__ import annotations

import numpy as np
import pytest
from fci_client import RawArm

from uniforce_robots.fr3 import DQ_MAX_rad_s, TAU_MAX_Nm, translation
from uniforce_robots.standins.fci import protocol as p
from uniforce_robots.standins.fci.arm import Arm
from uniforce_robots.standins.fci.process import StandIn
from uniforce_robots.standins.fci.protocol import ErrorBit, Generator, RobotCommand
from uniforce_robots.standins.fci.rules import (
    ACCELERATION_m_s2,
    DDQ_MAX_rad_s2,
    SPEED_m_s,
    TORQUE_STEP_Nm,
    broken_rules,
)

TICK_s = 0.001
HOME = Arm()


def torque(share: float) -> RobotCommand:
    return RobotCommand(1, tau_J_d=np.full(7, share * TORQUE_STEP_Nm))


def joint_step(share: float) -> RobotCommand:
    return RobotCommand(1, q_c=HOME.q_rad + share * DQ_MAX_rad_s * TICK_s)


def joint_speed_step(share: float) -> RobotCommand:
    return RobotCommand(1, dq_c=np.full(7, share * DDQ_MAX_rad_s2 * TICK_s))


def pose_step(share: float) -> RobotCommand:
    pose = translation(0, 0, share * SPEED_m_s * TICK_s) @ HOME.ee_to_base
    return RobotCommand(1, O_T_EE_c=pose.T.ravel())


def twist_step(share: float) -> RobotCommand:
    return RobotCommand(1, O_dP_EE_c=np.array([share * ACCELERATION_m_s2 * TICK_s, 0, 0, 0, 0, 0]))


STEPS = {
    "torque": (torque, Generator.NONE, ErrorBit.CONTROLLER_TORQUE_DISCONTINUITY),
    "joints": (joint_step, Generator.JOINT_POSITION, ErrorBit.JOINT_COMMAND_VELOCITY_LIMITS),
    "speeds": (joint_speed_step, Generator.JOINT_VELOCITY, ErrorBit.JOINT_COMMAND_VELOCITY_DISCONTINUITY),
    "pose": (pose_step, Generator.CARTESIAN_POSITION, ErrorBit.CARTESIAN_COMMAND_VELOCITY_LIMITS),
    "twist": (twist_step, Generator.CARTESIAN_VELOCITY, ErrorBit.CARTESIAN_COMMAND_VELOCITY_DISCONTINUITY),
}


@pytest.mark.parametrize("name", STEPS)
def test_a_step_at_the_limit_is_followed_and_a_larger_one_is_named(name: str) -> None:
    make, generator, bit = STEPS[name]
    rest = RobotCommand(0, q_c=HOME.q_rad, O_T_EE_c=HOME.ee_to_base.T.ravel())
    assert broken_rules(make(1.0), rest, generator, HOME) == frozenset()
    assert broken_rules(make(1.1), rest, generator, HOME) == {bit}


@pytest.mark.parametrize("name", ["speeds", "twist"])
def test_where_packets_were_lost_a_motion_may_have_gone_on(name: str) -> None:
    make, generator, bit = STEPS[name]
    before = RobotCommand(-4)
    assert broken_rules(make(5.0), before, generator, HOME) == frozenset()
    assert broken_rules(make(5.5), before, generator, HOME) == {bit}


def test_a_first_command_starts_where_the_arm_is() -> None:
    far = RobotCommand(1, q_c=HOME.q_rad + 0.1, O_T_EE_c=(translation(0, 0, 0.1) @ HOME.ee_to_base).T.ravel())
    for generator, bit in (
        (Generator.JOINT_POSITION, ErrorBit.JOINT_POSITION_START_POSE_INVALID),
        (Generator.CARTESIAN_POSITION, ErrorBit.CARTESIAN_POSITION_START_POSE_INVALID),
    ):
        assert broken_rules(far, None, generator, HOME) == {bit}


def test_values_beyond_the_robots_own_limits_are_named() -> None:
    strong = RobotCommand(1, tau_J_d=1.1 * TAU_MAX_Nm)
    assert broken_rules(strong, strong, Generator.NONE, HOME) == {ErrorBit.TAU_J_RANGE_VIOLATION}
    fast = RobotCommand(1, dq_c=1.1 * DQ_MAX_rad_s, O_dP_EE_c=np.array([0, 0, 3.3, 0, 0, 0]))
    for generator, bit in (
        (Generator.JOINT_VELOCITY, ErrorBit.JOINT_COMMAND_VELOCITY_LIMITS),
        (Generator.CARTESIAN_VELOCITY, ErrorBit.CARTESIAN_COMMAND_VELOCITY_LIMITS),
    ):
        assert broken_rules(fast, fast, generator, HOME) == {bit}
    for frame in (np.zeros(16), np.full(16, 1e200)):
        bent = RobotCommand(1, O_T_EE_c=frame)
        bits = broken_rules(bent, None, Generator.CARTESIAN_POSITION, HOME)
        assert bits == {ErrorBit.CARTESIAN_COMMAND_INVALID_FRAME}


@pytest.mark.slow
@pytest.mark.parametrize("rules", [True, False])
def test_a_torque_step_ends_the_motion_before_the_arm_follows_unless_the_rules_are_off(
    address: str, rules: bool
) -> None:
    options = [] if rules else ["--no-rules"]
    with StandIn(address, *options) as fci, RawArm(address) as arm:
        arm.state()
        arm.start()
        for _ in range(5):
            state = arm.newest()
            arm.command(RobotCommand(state.message_id, tau_J_d=np.array([0, 5.0, 0, 0, 0, 0, 0])))
        look = fci.do("look")["arm"]
        assert look["moving"] is not rules
        if rules:
            assert arm.receive().payload == bytes([p.MoveStatus.REFLEX_ABORTED])
            assert look["errors"] == [ErrorBit.CONTROLLER_TORQUE_DISCONTINUITY]
            assert look["last_moving_ms"] is None, "it was never followed"
        else:
            assert look["tau_Nm"][1] == 5.0


@pytest.mark.slow
def test_the_rules_can_be_switched_while_it_runs(fci: StandIn) -> None:
    with RawArm(fci.address) as arm:
        fci.do("rules", on=False)
        arm.state()
        arm.start()
        arm.command(RobotCommand(arm.newest().message_id, tau_J_d=np.full(7, 3.0)))
        arm.newest()
        assert fci.do("look")["arm"]["moving"]
