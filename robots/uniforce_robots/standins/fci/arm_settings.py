"""Requests that only set something on the arm: each is read whole before anything changes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from uniforce_robots.standins.fci.arm import Arm
from uniforce_robots.standins.fci.journal import Journal
from uniforce_robots.standins.fci.protocol import (
    CARTESIAN_IMPEDANCE_COUNT,
    GUIDING,
    JOINT_IMPEDANCE_COUNT,
    TRANSFORM_COUNT,
    ArmCommand,
    CollisionBehavior,
    Load,
    Message,
    ProtocolError,
    numbers,
    unpack,
)

ROUNDING = 1e-3  # of a rotation matrix a client computed


def setting(arm: Arm, journal: Journal, message: Message) -> Callable[[], None]:
    """Return what applies a setter's values; call it where the setter is allowed.

    Raises:
        ProtocolError: no setter of this protocol, another size, or values that make no sense.
    """
    payload = message.payload
    match message.command:
        case ArmCommand.SET_COLLISION_BEHAVIOR:
            behavior = CollisionBehavior.decode(payload)
            return lambda: _set_thresholds(arm, journal, behavior)
        case ArmCommand.SET_JOINT_IMPEDANCE:
            numbers(payload, JOINT_IMPEDANCE_COUNT, "SetJointImpedance")
        case ArmCommand.SET_CARTESIAN_IMPEDANCE:
            numbers(payload, CARTESIAN_IMPEDANCE_COUNT, "SetCartesianImpedance")
        case ArmCommand.SET_GUIDING_MODE:
            unpack(GUIDING, payload, "SetGuidingMode")
        case ArmCommand.SET_EE_TO_K:
            k_to_ee = _transform(payload, "SetEEToK")
            return lambda: setattr(arm, "k_to_ee", k_to_ee)
        case ArmCommand.SET_NE_TO_EE:
            ee_to_ne = _transform(payload, "SetNEToEE")
            return lambda: arm.set_ee(ee_to_ne)
        case ArmCommand.SET_LOAD:
            Load.decode(payload)
        case _:
            raise ProtocolError("arm command", "0 to 11", message.command)
    return _nothing


def _nothing() -> None:
    """Do nothing: the stand-in's dynamics don't depend on this value."""


def _transform(payload: bytes, what: str) -> np.ndarray:
    transform = numbers(payload, TRANSFORM_COUNT, what).reshape(4, 4).T
    turn = transform[:3, :3]
    if np.abs(transform).max() > 2 or np.abs(turn @ turn.T - np.eye(3)).max() > ROUNDING:
        raise ProtocolError(what, "a rotation and at most 2 m", "another matrix")
    return transform


def _set_thresholds(arm: Arm, journal: Journal, behavior: CollisionBehavior) -> None:
    arm.upper_torque_Nm = behavior.upper_torque_nominal
    arm.upper_force_N = behavior.upper_force_nominal
    thresholds = {"upper_torque_Nm": behavior.upper_torque_nominal.tolist()}
    journal.write("thresholds", **thresholds, upper_force_N=behavior.upper_force_nominal.tolist())
