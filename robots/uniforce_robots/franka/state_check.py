"""Is what the robot reports possible? Finite, continuous, within its own speed limits, from a clock that advances."""

import numpy as np

from uniforce_robots.fr3 import DQ_MAX_rad_s
from uniforce_robots.franka.arm import ArmState
from uniforce_vtla.errors import RobotError, expected

JOINT_SPEED_rad_s = 1.2 * DQ_MAX_rad_s  # a fifth more than a joint can do is no measurement
HAND_SPEED_m_s, HAND_TURN_rad_s = 2.0, 3.0
LONGEST_s = 0.02  # after a longer pause the allowed distance is counted from here: a pause excuses no jump
NOISE_m, NOISE_rad = 0.005, 0.05
RESTART = "restart the robot's controller."
ROTATION_ERROR = 1e-2  # of RᵀR from the identity
LEAD_m = 0.015  # closer to its target the spring is not clipped, so a target that moves moves the arm
# a target went so far and no joint changed by a single bit, by the robot's clock: a busy computer whose command is late
# by some milliseconds is no frozen robot
FROZEN_m, FROZEN_s = 0.005, 0.1


class StateCheck:
    """Compare each reading with the one before. ``reset`` by making a new one."""

    def __init__(self) -> None:
        self._last: ArmState | None = None
        self._target_m: np.ndarray | None = None
        self._unanswered_m, self._changed_s = 0.0, 0.0

    def __call__(self, state: ArmState) -> None:
        """Accept a reading.

        Raises:
            RobotError: ``bad_state`` (no numbers, no rotation, a clock that runs backwards), ``force`` (the force
                estimate is lost), ``speed`` or ``jump`` (faster than the arm can be), ``frozen`` (its target moved and
                the joints did not change by a single bit).
        """
        _require_possible(state)
        if self._last is not None:
            _require_continuous(self._last, state)
            self._require_alive(self._last, state)
        self._last = state

    def follows(self, target_m: np.ndarray) -> None:
        """Note where the arm is pulled to, (3,) base frame m."""
        if self._target_m is not None and self._last is not None:
            lead_m = float(np.linalg.norm(target_m - self._last.ee_to_base[:3, 3]))
            step_m = float(np.linalg.norm(target_m - self._target_m))
            self._unanswered_m += step_m if lead_m < LEAD_m else 0.0
        self._target_m = target_m

    def _require_alive(self, last: ArmState, state: ArmState) -> None:
        if not np.array_equal(last.q_rad, state.q_rad) or not self._unanswered_m:
            self._unanswered_m, self._changed_s = 0.0, state.robot_time_s
        if self._unanswered_m > FROZEN_m and state.robot_time_s - self._changed_s > FROZEN_s:
            came = f"none while the target moved {1000 * self._unanswered_m:.0f} mm"
            raise _wrong("arm state", "joints that change", came, "frozen")


def _require_possible(state: ArmState) -> None:
    pose, joints = state.ee_to_base, (state.q_rad, state.dq_rad_s)
    whole = np.isfinite(pose).all() and all(np.isfinite(row).all() for row in joints)
    if not (whole and np.isfinite(state.robot_time_s)):
        raise _wrong("arm state", "finite numbers", "NaN or infinity", "bad_state")
    rotation = pose[:3, :3]
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > ROTATION_ERROR or np.linalg.det(rotation) < 0:
        raise _wrong("arm state", "a rotation in its pose", rotation.round(3).tolist(), "bad_state")
    if (np.abs(state.dq_rad_s) > JOINT_SPEED_rad_s).any():
        came, do = state.dq_rad_s.round(2).tolist(), f"Its encoders or the network are wrong; {RESTART}"
        raise _wrong("joint speed", "within the data sheet's", came, "speed", do)
    if not np.isfinite(state.wrench_N).all():
        came, do = state.wrench_N.round(2).tolist(), f"Without it nothing bounds a press; {RESTART}"
        raise _wrong("force estimate", "finite numbers", came, "force", do)


def _require_continuous(last: ArmState, state: ArmState) -> None:
    elapsed_s = state.robot_time_s - last.robot_time_s
    if elapsed_s < 0:
        raise _wrong("arm state", "a clock that advances", f"{1000 * elapsed_s:.0f} ms", "bad_state")
    elapsed_s = min(elapsed_s, LONGEST_s)
    moved_m = float(np.linalg.norm(state.ee_to_base[:3, 3] - last.ee_to_base[:3, 3]))
    turned_rad = _angle(last.ee_to_base[:3, :3].T @ state.ee_to_base[:3, :3])
    jumped = np.abs(state.q_rad - last.q_rad) > JOINT_SPEED_rad_s * elapsed_s + NOISE_rad
    far = moved_m > HAND_SPEED_m_s * elapsed_s + NOISE_m
    turned = turned_rad > HAND_TURN_rad_s * elapsed_s + NOISE_rad
    if far or turned or jumped.any():
        came = f"{1000 * moved_m:.0f} mm and {turned_rad:.2f} rad in {1000 * elapsed_s:.0f} ms"
        raise _wrong("arm state", "a continuous motion", came, "jump")


def _angle(rotation: np.ndarray) -> float:
    """Return the angle of a (3, 3) rotation, rad."""
    return float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))


def _wrong(what: str, wanted: str, came: object, fault: str, do: str = "") -> RobotError:
    return RobotError(expected(what, wanted, came, do or f"Nothing it reports can be used; {RESTART}"), fault)
