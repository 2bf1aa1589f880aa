"""The last check of a pose that is about to be sent, whatever computed it. It corrects nothing: it refuses."""

import numpy as np

from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.franka.poses import ToolPose, shortest_turn
from uniforce_vtla.errors import RobotError, expected

HERE_m, HERE_rad = 1e-3, 1e-2  # closer to the measured pose than this a target pulls at nothing
ROUNDING = 1e-6


class SendCheck:
    """Keep what was sent last and refuse what is no small step from it.

    A pose passes when it is finite; inside the box, or not further out of it than the last one or the arm itself;
    within speed × time of the last one, unless it is where the arm is; and near the arm.
    """

    def __init__(self, limits: GuardLimits) -> None:
        self._limits = limits
        self._low, self._high = np.array(limits.low[:4]), np.array(limits.high[:4])
        self._last: np.ndarray | None = None
        self._last_s = 0.0

    def __call__(self, pose: ToolPose, measured: ToolPose, now_s: float) -> None:
        """Accept a pose as sent at ``now_s``; raises RobotError: ``guard``: the pose must not be sent."""
        target, here = _axes(pose), _axes(measured)
        last = here if self._last is None else self._last
        gap_s = self._limits.longest_gap_s
        elapsed_s = gap_s if self._last is None else min(max(now_s - self._last_s, 0.0), gap_s)
        if not np.isfinite(target).all():
            raise _refused("finite numbers", target)
        self._require_box(target, last, here)
        self._require_rate(target, last, here, elapsed_s)
        self._require_near(target, here)
        self._last, self._last_s = target, now_s

    def _require_box(self, target: np.ndarray, last: np.ndarray, here: np.ndarray) -> None:
        low = np.minimum(np.minimum(last, here), self._low) - ROUNDING
        high = np.maximum(np.maximum(last, here), self._high) + ROUNDING
        if not ((low <= target) & (target <= high)).all():
            raise _refused(f"inside the box {self._low.tolist()} … {self._high.tolist()}", target)

    def _require_rate(self, target: np.ndarray, last: np.ndarray, here: np.ndarray, elapsed_s: float) -> None:
        if _distance(target, here) <= HERE_m and _turn(target, here) <= HERE_rad:
            return  # it lets go: the pull becomes nothing, however far the last target was
        limits = self._limits
        slow = _distance(target, last) <= limits.speed_m_s * elapsed_s + ROUNDING
        if not (slow and _turn(target, last) <= limits.speed_rad_s * elapsed_s + ROUNDING):
            raise _refused(f"at most {limits.speed_m_s} m/s from {last.round(4).tolist()} in {elapsed_s:.3f} s", target)

    def _require_near(self, target: np.ndarray, here: np.ndarray) -> None:
        """A target was within a step of the arm when it was chosen; since then the arm may have moved a little."""
        limits = self._limits
        reach_m = limits.step_m + limits.speed_m_s * limits.longest_gap_s
        reach_rad = limits.step_rad + limits.speed_rad_s * limits.longest_gap_s
        if _distance(target, here) > reach_m + ROUNDING or _turn(target, here) > reach_rad + ROUNDING:
            wanted = f"within {reach_m:.3f} m and {reach_rad:.2f} rad of the arm at {here.round(4).tolist()}"
            raise _refused(wanted, target, "Not sent: has something pushed the arm away? See to it.")


def _axes(pose: ToolPose) -> np.ndarray:
    """(4,) x, y, z m, yaw rad."""
    return np.array([*pose.position_m, pose.yaw_rad], dtype=float)


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a[:3] - b[:3]))


def _turn(a: np.ndarray, b: np.ndarray) -> float:
    return abs(shortest_turn(float(a[3]), float(b[3])))


def _refused(wanted: str, target: np.ndarray, do: str = "Not sent; please report it.") -> RobotError:
    return RobotError(expected("target to send", wanted, target.round(4).tolist(), do), "guard")
