"""What a real robot refuses in a client's commands, checked before the arm follows them.

The limits are those of the FR3 in Franka's interface specification and in libfranka's rate_limiting.h; how much a real
controller tolerates beyond them is not published, so a small share is allowed. Jerk is not checked.
"""

from __future__ import annotations

import numpy as np

from uniforce_robots.fr3 import DQ_MAX_rad_s, TAU_MAX_Nm, rotation_error
from uniforce_robots.standins.fci.arm import Arm, TICK_s
from uniforce_robots.standins.fci.protocol import ErrorBit, Generator, RobotCommand

TOLERANCE = 1.01  # states are float32, and a client's rounding is no fault
TORQUE_STEP_Nm = 1.0  # a millisecond: 1000 Nm/s
DDQ_MAX_rad_s2 = 10.0
SPEED_m_s, TURN_rad_s = 3.0, 2.5
ACCELERATION_m_s2, TURN_rad_s2 = 9.0, 17.0
PACKETS = 20  # so many lost ones are made up for by constant motion; more end it
ROUNDING = 1e-3


def broken_rules(
    command: RobotCommand, before: RobotCommand | None, generator: Generator, arm: Arm
) -> frozenset[int]:
    """Return the error bits of a command that follows on ``before`` (None: on rest, where the arm is)."""
    gap = command.message_id - before.message_id if before else 1
    elapsed_s = TICK_s * min(max(gap, 1), PACKETS)  # the robot goes on by itself where packets are lost
    match generator:
        case Generator.NONE:
            broken = _torque(command.tau_J_d, before)
        case Generator.JOINT_POSITION:
            broken = _joint_position(command.q_c, before, arm, elapsed_s)
        case Generator.JOINT_VELOCITY:
            broken = _joint_velocity(command.dq_c, before, elapsed_s)
        case Generator.CARTESIAN_POSITION:
            broken = _pose(command.O_T_EE_c.reshape(4, 4).T, before, arm, elapsed_s)
        case Generator.CARTESIAN_VELOCITY:
            broken = _twist(command.O_dP_EE_c, before, elapsed_s)
    return frozenset(bit for bit, is_broken in broken.items() if is_broken)


def _torque(tau_Nm: np.ndarray, before: RobotCommand | None) -> dict[ErrorBit, bool]:
    step = tau_Nm - (before.tau_J_d if before else 0.0)
    return {
        ErrorBit.CONTROLLER_TORQUE_DISCONTINUITY: _beyond(step, TORQUE_STEP_Nm),
        ErrorBit.TAU_J_RANGE_VIOLATION: _beyond(tau_Nm, TAU_MAX_Nm),
    }


def _joint_position(
    q_rad: np.ndarray, before: RobotCommand | None, arm: Arm, elapsed_s: float
) -> dict[ErrorBit, bool]:
    too_fast = _beyond(q_rad - (before.q_c if before else arm.q_rad), DQ_MAX_rad_s * elapsed_s)
    start, later = ErrorBit.JOINT_POSITION_START_POSE_INVALID, ErrorBit.JOINT_COMMAND_VELOCITY_LIMITS
    return {later if before else start: too_fast}


def _joint_velocity(
    dq_rad_s: np.ndarray, before: RobotCommand | None, elapsed_s: float
) -> dict[ErrorBit, bool]:
    step = dq_rad_s - (before.dq_c if before else 0.0)
    return {
        ErrorBit.JOINT_COMMAND_VELOCITY_LIMITS: _beyond(dq_rad_s, DQ_MAX_rad_s),
        ErrorBit.JOINT_COMMAND_VELOCITY_DISCONTINUITY: _beyond(step, DDQ_MAX_rad_s2 * elapsed_s),
    }


def _pose(pose: np.ndarray, before: RobotCommand | None, arm: Arm, elapsed_s: float) -> dict[ErrorBit, bool]:
    turn = pose[:3, :3]
    if np.abs(turn).max() > 1 + ROUNDING or np.abs(turn @ turn.T - np.eye(3)).max() > ROUNDING:
        return {ErrorBit.CARTESIAN_COMMAND_INVALID_FRAME: True}
    last = before.O_T_EE_c.reshape(4, 4).T if before else arm.ee_to_base
    moved = _longer(pose[:3, 3] - last[:3, 3], SPEED_m_s * elapsed_s)
    turned = _longer(rotation_error(turn, last[:3, :3]), TURN_rad_s * elapsed_s)
    start, later = ErrorBit.CARTESIAN_POSITION_START_POSE_INVALID, ErrorBit.CARTESIAN_COMMAND_VELOCITY_LIMITS
    return {later if before else start: moved or turned}


def _twist(twist: np.ndarray, before: RobotCommand | None, elapsed_s: float) -> dict[ErrorBit, bool]:
    step = twist - (before.O_dP_EE_c if before else 0.0)
    too_fast = _longer(twist[:3], SPEED_m_s) or _longer(twist[3:], TURN_rad_s)
    linear = _longer(step[:3], ACCELERATION_m_s2 * elapsed_s)
    jumps = linear or _longer(step[3:], TURN_rad_s2 * elapsed_s)
    return {
        ErrorBit.CARTESIAN_COMMAND_VELOCITY_LIMITS: too_fast,
        ErrorBit.CARTESIAN_COMMAND_VELOCITY_DISCONTINUITY: jumps,
    }


def _beyond(values: np.ndarray, limit: np.ndarray | float) -> bool:
    return bool((np.abs(values) > TOLERANCE * limit).any())


def _longer(vector: np.ndarray, limit: float) -> bool:
    return bool(np.abs(vector).max() > TOLERANCE * limit or vector @ vector > (TOLERANCE * limit) ** 2)
