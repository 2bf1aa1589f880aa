"""Guards of an action: finite → workspace box → step → rate. NaN stops, the rest clamps.

Behind them stand the check of each sent pose (``state_check.SendCheck``), the tracker's clip
(stiffness × clip bounds the force) and the robot's own reflex.
"""

import logging
from dataclasses import dataclass

import numpy as np

from uniforce_robots.franka.limits import require_in_limits
from uniforce_robots.franka.poses import shortest_turn
from uniforce_vtla.errors import ContractError, RobotError, expected
from uniforce_vtla.keys import AXES

log = logging.getLogger(__name__)
# the last one acts on a camera, not on an action
GUARDS = ("finite", "box", "step", "rate", "sensor")


@dataclass(frozen=True)
class GuardLimits:
    """Limits in the robot's base frame, axes as in ``keys.AXES``: x, y, z m, yaw rad, width m.

    Each has a hard limit in ``limits.HARD_LIMITS``.
    """

    # the workspace box: measure your own
    low: tuple[float, ...] = (0.30, -0.30, 0.005, -np.pi / 2, 0.0)
    high: tuple[float, ...] = (0.70, 0.30, 0.50, np.pi / 2, 0.08)
    # Largest distance of a target from the measured pose. Wider than the tracker's clip: it catches
    # a policy gone astray rather than one that presses.
    step_m: float = 0.05
    step_rad: float = 0.35
    speed_m_s: float = 0.25  # of the target
    speed_rad_s: float = 1.5
    speed_width_m_s: float = 0.1
    longest_gap_s: float = 0.1  # a longer pause counts as this long, so that it does not buy a jump
    # A hand tilted farther from straight down is refused: no action could bring it back.
    tilt_rad: float = 0.15

    def __post_init__(self) -> None:
        require_in_limits(self)
        if not np.all(np.less(self.low, self.high)):
            wanted = f"low < high for {AXES}"
            came = f"{self.low}, {self.high}"
            raise ContractError(expected("workspace box", wanted, came, "Check the config."))


class GuardChain:
    """Apply the limits in order. ``counts`` says how often each guard acted."""

    def __init__(self, limits: GuardLimits) -> None:
        self.limits = limits
        self.counts = dict.fromkeys(GUARDS, 0)
        self._acting: set[str] = set()
        self._last: np.ndarray | None = None
        self._last_s = 0.0

    def reset(self) -> None:
        """Forget the last target; the next one is counted from the measured pose."""
        self._last = None

    def start_from(self, axes: np.ndarray) -> None:
        """Count the next action from (5,) axes, where the robot was kept."""
        self._last = axes
        self._last_s = -np.inf

    def __call__(self, action: np.ndarray, measured: np.ndarray, now_s: float) -> np.ndarray:
        """Return the action that may be sent.

        Args:
            action: (5,) absolute target.
            measured: (5,) where the robot is.
            now_s: a monotonic clock.

        Raises RobotError: a number that is not finite: nothing sensible can be made of it.
        """
        self._finite(action, measured)
        gap_s = self.limits.longest_gap_s
        last = measured
        elapsed_s = gap_s
        if self._last is not None:
            last = self._last
            elapsed_s = min(max(now_s - self._last_s, 0.0), gap_s)
        boxed = self._note("box", action, self._box(action, measured))
        stepped = self._note("step", boxed, self._step(boxed, measured))
        slowed = self._note("rate", stepped, self._rate(stepped, last, elapsed_s))
        sent = self._box(slowed, last)
        self._last = sent
        self._last_s = now_s
        return sent

    def _finite(self, action: np.ndarray, measured: np.ndarray) -> None:
        if not np.isfinite(measured).all():
            do = "Nothing can be sent; the robot stops."
            raise RobotError(
                expected("measured pose", "finite numbers", measured.tolist(), do), "bad_state"
            )
        if action.shape == (len(AXES),) and np.isfinite(action).all():
            return
        self.counts["finite"] += 1
        do = "The policy or the teleoperator is broken; the robot stops."
        raise RobotError(
            expected("action", f"{len(AXES)} finite numbers", action.tolist(), do), "action"
        )

    def _box(self, action: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Clamp to the box; an axis that starts outside may come back, never go farther."""
        return np.clip(
            action, np.minimum(self.limits.low, start), np.maximum(self.limits.high, start)
        )

    def _step(self, action: np.ndarray, measured: np.ndarray) -> np.ndarray:
        near = action.copy()
        near[:3] = towards(measured[:3], action[:3], self.limits.step_m)
        near[3] = turn_towards(measured[3], action[3], self.limits.step_rad)
        return near

    def _rate(self, action: np.ndarray, last: np.ndarray, elapsed_s: float) -> np.ndarray:
        limits = self.limits
        slow = action.copy()
        slow[:3] = towards(last[:3], action[:3], limits.speed_m_s * elapsed_s)
        slow[3] = turn_towards(last[3], action[3], limits.speed_rad_s * elapsed_s)
        reach = limits.speed_width_m_s * elapsed_s
        slow[4] = np.clip(action[4], last[4] - reach, last[4] + reach)
        return slow

    def _note(self, guard: str, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Count a guard that acted; log when it begins to, not 30 times a second."""
        acts = not np.allclose(before, after, rtol=0, atol=1e-9)
        if acts:
            self.counts[guard] += 1
            if guard not in self._acting:
                was = before.round(4).tolist()
                became = after.round(4).tolist()
                log.warning("guard %s: %s became %s", guard, was, became)
            self._acting.add(guard)
        else:
            self._acting.discard(guard)
        return after


def towards(start: np.ndarray, goal: np.ndarray, reach: float) -> np.ndarray:
    """Return the goal, or the point at ``reach`` on the straight way to it."""
    distance = float(np.linalg.norm(goal - start))
    if distance <= reach:
        return goal
    return start + (goal - start) * reach / distance


def turn_towards(start_rad: float, goal_rad: float, reach_rad: float) -> float:
    """Return the goal, or ``reach_rad`` of the shorter turn to it."""
    turn = shortest_turn(start_rad, goal_rad)
    if abs(turn) <= reach_rad:
        return goal_rad
    return start_rad + float(np.clip(turn, -reach_rad, reach_rad))
