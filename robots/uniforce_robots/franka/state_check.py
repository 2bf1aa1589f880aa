"""Two checks that refuse and correct nothing: of each reading, and of each pose before it is sent.

A reading must be finite, continuous, within the robot's own speed limits, from a clock that
advances. A pose is checked last, whatever computed it.
"""

import numpy as np

from uniforce_robots.fr3 import DQ_MAX_rad_s
from uniforce_robots.franka.arm import ArmState
from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.franka.poses import ToolPose, shortest_turn
from uniforce_vtla.errors import RobotError, expected

JOINT_SPEED_rad_s = 1.2 * DQ_MAX_rad_s  # a fifth more than a joint can do is no measurement
HAND_SPEED_m_s = 2.0
HAND_TURN_rad_s = 3.0
# after a longer pause the allowed distance is counted from here: a pause excuses no jump
LONGEST_s = 0.02
NOISE_m = 0.005
NOISE_rad = 0.05
RESTART = "restart the robot's controller."
ROTATION_ERROR = 1e-2  # of RᵀR from the identity
# closer to its target the spring is not clipped, so a target that moves moves the arm
LEAD_m = 0.015
# a target went so far and no joint changed by a single bit, by the robot's clock: a command that is
# late by some milliseconds means no frozen robot
FROZEN_m = 0.003
FROZEN_s = 0.1


class StateCheck:
    """Compare each reading with the one before. ``reset`` by making a new one."""

    def __init__(self) -> None:
        self._last: ArmState | None = None
        self._target_m: np.ndarray | None = None
        self._unanswered_m = 0.0
        self._changed_s = 0.0

    def __call__(self, state: ArmState) -> None:
        """Accept a reading.

        Raises RobotError: ``bad_state`` (no numbers, no rotation, a clock that runs backwards),
        ``force`` (the force estimate is lost), ``speed`` or ``jump`` (faster than the arm can be),
        ``frozen`` (its target moved and the joints did not change by a single bit).
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
            if lead_m < LEAD_m:
                self._unanswered_m += step_m
        self._target_m = target_m

    def _require_alive(self, last: ArmState, state: ArmState) -> None:
        if not np.array_equal(last.q_rad, state.q_rad) or not self._unanswered_m:
            self._unanswered_m = 0.0
            self._changed_s = state.robot_time_s
        if self._unanswered_m > FROZEN_m and state.robot_time_s - self._changed_s > FROZEN_s:
            came = f"none while the target moved {1000 * self._unanswered_m:.0f} mm"
            raise _wrong("arm state", "joints that change", came, "frozen")


def _require_possible(state: ArmState) -> None:
    pose = state.ee_to_base
    joints = (state.q_rad, state.dq_rad_s)
    whole = np.isfinite(pose).all() and all(np.isfinite(row).all() for row in joints)
    if not (whole and np.isfinite(state.robot_time_s)):
        raise _wrong("arm state", "finite numbers", "NaN or infinity", "bad_state")
    rotation = pose[:3, :3]
    if (
        np.abs(rotation.T @ rotation - np.eye(3)).max() > ROTATION_ERROR
        or np.linalg.det(rotation) < 0
    ):
        raise _wrong("arm state", "a rotation in its pose", rotation.round(3).tolist(), "bad_state")
    if (np.abs(state.dq_rad_s) > JOINT_SPEED_rad_s).any():
        came = state.dq_rad_s.round(2).tolist()
        do = f"Its encoders or the network are wrong; {RESTART}"
        raise _wrong("joint speed", "within the data sheet's", came, "speed", do)
    if not np.isfinite(state.wrench_N).all():
        came = state.wrench_N.round(2).tolist()
        do = f"Without it nothing bounds a press; {RESTART}"
        raise _wrong("force estimate", "finite numbers", came, "force", do)


def _require_continuous(last: ArmState, state: ArmState) -> None:
    elapsed_s = state.robot_time_s - last.robot_time_s
    if elapsed_s < 0:
        raise _wrong(
            "arm state", "a clock that advances", f"{1000 * elapsed_s:.0f} ms", "bad_state"
        )
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
    return RobotError(
        expected(what, wanted, came, do or f"Nothing it reports can be used; {RESTART}"), fault
    )


def require_upright(state: ArmState, limit_rad: float) -> None:
    """Refuse a hand that points too far from straight down; raises RobotError: ``tilt``."""
    tilt_rad = float(np.linalg.norm(ToolPose.from_ee(state.ee_to_base).tilt_rad))
    if tilt_rad > limit_rad:
        wanted = f"a hand within {np.degrees(limit_rad):.0f}° of straight down"
        do = "Lead it upright by hand with the guiding buttons, then recover or connect."
        raise RobotError(expected("tilt", wanted, f"{np.degrees(tilt_rad):.0f}°", do), "tilt")


# closer to the measured pose than this a target pulls at nothing
HERE_m = 1e-3
HERE_rad = 1e-2
ROUNDING = 1e-6


class SendCheck:
    """Keep the last pose sent and refuse one that is no small step from it.

    A pose passes when it is finite; inside the box, or no further out than the last one or the arm;
    tilted no further than the limit, the last one or the arm; within speed × time of the last one,
    unless it is where the arm is; and near the arm.
    """

    def __init__(self, limits: GuardLimits) -> None:
        self._limits = limits
        self._low = np.array(limits.low[:4])
        self._high = np.array(limits.high[:4])
        self._last: np.ndarray | None = None
        self._last_s = 0.0

    def __call__(self, pose: ToolPose, measured: ToolPose, now_s: float) -> None:
        """Accept a pose as sent at ``now_s``; raises RobotError: ``guard``: it must not be sent."""
        target = _axes(pose)
        here = _axes(measured)
        last = here
        elapsed_s = gap_s = self._limits.longest_gap_s
        if self._last is not None:
            last = self._last
            elapsed_s = min(max(now_s - self._last_s, 0.0), gap_s)
        if not np.isfinite(target).all():
            raise _refused("finite numbers", target)
        self._require_box(target, last, here)
        self._require_tilt(target, last, here)
        self._require_rate(target, last, here, elapsed_s)
        self._require_near(target, here)
        self._last = target
        self._last_s = now_s

    def _require_box(self, target: np.ndarray, last: np.ndarray, here: np.ndarray) -> None:
        low = np.minimum(np.minimum(last, here)[:4], self._low) - ROUNDING
        high = np.maximum(np.maximum(last, here)[:4], self._high) + ROUNDING
        if not ((low <= target[:4]) & (target[:4] <= high)).all():
            raise _refused(f"inside the box {self._low.tolist()} … {self._high.tolist()}", target)

    def _require_tilt(self, target: np.ndarray, last: np.ndarray, here: np.ndarray) -> None:
        allowed_rad = max(self._limits.tilt_rad, _tilt_of(last), _tilt_of(here))
        if _tilt_of(target) > allowed_rad + ROUNDING:
            raise _refused(f"a tilt of at most {allowed_rad:.3f} rad", target)

    def _require_rate(
        self, target: np.ndarray, last: np.ndarray, here: np.ndarray, elapsed_s: float
    ) -> None:
        if _distance(target, here) <= HERE_m and _turn(target, here) <= HERE_rad:
            return  # it lets go: the pull becomes nothing, however far the last target was
        limits = self._limits
        slow = _distance(target, last) <= limits.speed_m_s * elapsed_s + ROUNDING
        if not (slow and _turn(target, last) <= limits.speed_rad_s * elapsed_s + ROUNDING):
            way = f"from {last.round(4).tolist()} in {elapsed_s:.3f} s"
            raise _refused(f"at most {limits.speed_m_s} m/s {way}", target)

    def _require_near(self, target: np.ndarray, here: np.ndarray) -> None:
        """Refuse a target too far from the arm, which may have moved since it was chosen."""
        limits = self._limits
        reach_m = limits.step_m + limits.speed_m_s * limits.longest_gap_s
        reach_rad = limits.step_rad + limits.speed_rad_s * limits.longest_gap_s
        if (
            _distance(target, here) > reach_m + ROUNDING
            or _turn(target, here) > reach_rad + ROUNDING
        ):
            reach = f"{reach_m:.3f} m and {reach_rad:.2f} rad"
            wanted = f"within {reach} of the arm at {here.round(4).tolist()}"
            do = "Not sent: has something pushed the arm away? See to it."
            raise _refused(wanted, target, do)


def _axes(pose: ToolPose) -> np.ndarray:
    """Return (7,) x, y, z m, yaw rad, tilt as a rotation vector rad."""
    return np.array([*pose.position_m, pose.yaw_rad, *pose.tilt_rad], dtype=float)


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a[:3] - b[:3]))


def _turn(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm([shortest_turn(float(a[3]), float(b[3])), *(a[4:] - b[4:])]))


def _tilt_of(axes: np.ndarray) -> float:
    return float(np.linalg.norm(axes[4:]))


def _refused(
    wanted: str, target: np.ndarray, do: str = "Not sent; please report it."
) -> RobotError:
    return RobotError(expected("target to send", wanted, target.round(4).tolist(), do), "guard")
