"""A reading of the arm, the faults it can have, and its gains.

Poses are (4, 4) ``ee_to_base``: the frame between the finger tips in the robot's base frame, m.
On a Franka Hand the fingers close along that frame's y axis and z points out of the hand.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from uniforce_robots.fr3 import HAND_TO_FLANGE
from uniforce_robots.franka.limits import FORCE_N, TORQUE_Nm, require_in_limits
from uniforce_vtla.errors import ContractError, RobotError, expected

# A mode in which nothing may move, and the RobotError.fault it means.
STOPPED_MODES = {"reflex": "reflex", "user_stopped": "user_stop", "guiding": "guiding"}
FAULTS_OF_READINGS = ("bad_state", "jump", "speed", "frozen", "connection", "stale")
# Every fault of an arm that has stopped by itself and can still be read.
ROBOT_STOPS = (*STOPPED_MODES.values(), "communication", "discontinuity", "limit")
FAULT_BY_ROBOT_WORD = {
    "communication": "communication",
    "discontinuity": "discontinuity",
    "violation": "limit",
}
FAULT_BY_CLIENT_WORD = {
    "incompatible": "version",
    "infinite or nan": "bad_state",
    "user stop": "user_stop",
    "reflex": "reflex",
    **dict.fromkeys(("timeout", "connection", "network", "tcp", "udp"), "connection"),
}
CLIENT_ADVICE = {"realtime": "Set robot.realtime=ignore, or boot a PREEMPT_RT kernel."}
# the setup may differ from the assumed one by so much
FRAME_m = 0.002
FRAME_rad = 0.02
LOAD_kg = 0.05


@dataclass(frozen=True)
class ArmState:
    """One reading of the arm."""

    time_s: float  # host clock (``time.monotonic``) at receipt
    robot_time_s: float  # the robot's own clock
    q_rad: np.ndarray  # (7,) joint angles
    dq_rad_s: np.ndarray  # (7,) joint speeds
    ee_to_base: np.ndarray  # (4, 4) measured pose
    # (6,) the robot's estimate of the external force N and moment Nm at the hand, base frame. From
    # motor currents: poor near singularities, never the only guard
    wrench_N: np.ndarray
    mode: str  # idle, move, guiding, reflex, user_stopped, recovery or other
    # share of the last 100 control commands that reached the robot in time; 0 without control
    success_rate: float
    # the robot's own names of what stopped it, as libfranka spells them
    errors: tuple[str, ...] = ()


@dataclass(frozen=True)
class ArmSetup:
    """Settings of the robot that other programs and Desk leave behind."""

    flange_to_ee: np.ndarray  # (4, 4) end-effector frame in the flange's, m
    load_kg: float  # payload beside the hand, in the arm's gravity compensation


def require_setup(setup: ArmSetup, load_kg: float) -> None:
    """Refuse an arm set up otherwise than the guards assume.

    Raises RobotError: ``frame``: another end effector than the Franka Hand, or another load.
    """
    apart = np.linalg.inv(HAND_TO_FLANGE) @ setup.flange_to_ee
    away_m = float(np.linalg.norm(apart[:3, 3]))
    turned_rad = float(Rotation.from_matrix(apart[:3, :3]).magnitude())
    if away_m > FRAME_m or turned_rad > FRAME_rad:
        came = f"one {1000 * away_m:.0f} mm away and turned by {math.degrees(turned_rad):.0f}°"
        do = "Choose the Franka Hand as end effector in Desk, or undo what another program has set."
        raise RobotError(expected("end-effector frame", "the Franka Hand's", came, do), "frame")
    if abs(setup.load_kg - load_kg) > LOAD_kg:
        do = "Set it in Desk, or state what the hand carries: robot.load_kg."
        raise RobotError(expected("load", f"{load_kg:g} kg", f"{setup.load_kg:g} kg", do), "frame")


def refuse_stopped(state: ArmState) -> None:
    """Refuse an arm that may not move.

    Raises RobotError: named after the cause: ``communication`` (commands came too late),
    ``discontinuity`` (a command jumped), ``limit`` (of a joint, a speed or power), ``reflex``,
    ``user_stop`` or ``guiding``.
    """
    if state.mode in STOPPED_MODES:
        fault = STOPPED_MODES[state.mode]
        if fault == "reflex":
            fault = fault_of_errors(state.errors)
        came = f"{state.mode} {', '.join(state.errors)}".strip()
        raise RobotError(
            expected("arm mode", "idle or move", came, "See to the robot, then call recover()."),
            fault,
        )


def fault_of_errors(errors: Iterable[str]) -> str:
    """Return the ``RobotError.fault`` of the robot's own error names."""
    text = " ".join(errors)
    for word, fault in FAULT_BY_ROBOT_WORD.items():
        if word in text:
            return fault
    return "reflex"


def fault_of(fault: str, text: str, errors: Iterable[str] = ()) -> str:
    """Return the ``RobotError.fault`` of a client's message, by libfranka's words.

    Args:
        fault: the child process's name of it; ``other`` where only the text says more.
        text: the client's message.
        errors: the robot's own error names.
    """
    if fault == "other":
        fault = next(
            (named for word, named in FAULT_BY_CLIENT_WORD.items() if word in text.lower()), "other"
        )
    if fault == "reflex":
        return fault_of_errors((*errors, text))
    return fault


def advised(text: str) -> str:
    """Return a client's message with advice, where its own words give none."""
    for word, do in CLIENT_ADVICE.items():
        if word in text.lower():
            text = f"{text} {do}"
    return text


@dataclass(frozen=True)
class Gains:
    """Stiffness of the Cartesian impedance, in the hand's frame, and how far the target may lead.

    Stiffness × ``clip_m`` bounds the spring's force whatever target comes. However the hand is
    turned, the force stays below ``limits.FORCE_N``.
    """

    # along the hand's x, y (the fingers close along y) and z
    stiffness_N_m: tuple[float, float, float]
    rotation_Nm_rad: tuple[float, float, float] = (60.0, 60.0, 60.0)  # about the same axes
    # largest position error the spring sees, along the base's x, y, z; largest rotation error
    clip_m: tuple[float, float, float] = (0.018, 0.018, 0.018)
    clip_rad: float = 0.2

    def __post_init__(self) -> None:
        require_in_limits(self)
        # clips are along the base's axes, stiffness along the hand's, turned about the vertical
        level_N = max(self.stiffness_N_m[:2]) * math.hypot(*self.clip_m[:2])
        force_N = math.hypot(level_N, self.stiffness_N_m[2] * self.clip_m[2])
        torque_Nm = max(self.rotation_Nm_rad) * self.clip_rad * math.sqrt(3)
        if force_N > FORCE_N or torque_Nm > TORQUE_Nm:
            most = f"{FORCE_N:g} N and {TORQUE_Nm:g} Nm"
            wanted = f"a spring of at most {most}, stiffness × clip of all axes"
            came = f"{force_N:.1f} N, {torque_Nm:.1f} Nm"
            raise ContractError(expected("gains", wanted, came, "Soften the arm or clip more."))

    def matrix_in_base(self, rotation: np.ndarray) -> np.ndarray:
        """Return the (6, 6) stiffness in the base frame, K = R K_ee Rᵀ for each block.

        ``rotation`` is the (3, 3) of ``ee_to_base``. A tracker takes its gains in the base frame:
        with the hand turned, only off-diagonal terms make the closing axis stiff.
        """
        turn = np.kron(np.eye(2), rotation)  # of both blocks
        return turn @ np.diag([*self.stiffness_N_m, *self.rotation_Nm_rad]) @ turn.T


# The simulated scene's own stiffness: 800 N/m × 18 mm bounds the press at 14.4 N.
ROLLOUT = Gains((2000.0, 2000.0, 800.0))
# Led by a person: soft but along the closing axis, so that a squeeze does not drag the arm.
HAND_GUIDED = Gains((200.0, 2000.0, 200.0), (20.0, 20.0, 20.0))
