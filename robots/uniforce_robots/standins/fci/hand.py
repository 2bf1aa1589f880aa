"""How the stand-in's hand moves: one width, one object that may stand between the fingers."""

from __future__ import annotations

from dataclasses import dataclass

from uniforce_robots.standins.fci.protocol import GraspRequest, HandMoveRequest, HandStatus

MAX_WIDTH_m = 0.08
HOMING_SPEED_m_s = 0.1
ARRIVED_m = 1e-6


@dataclass
class Hand:
    """Two fingers. ``start_*`` begins a motion; ``advance`` says how it ended, once it has."""

    width_m: float = MAX_WIDTH_m
    max_width_m: float = MAX_WIDTH_m
    object_m: float = 0.0  # width of what stands between the fingers; 0: nothing
    is_grasped: bool = False
    force_N: float = 0.0  # of the last grasp that held

    _goal_m: float | None = None
    _speed_m_s: float = 0.0
    _grasp: GraspRequest | None = None
    _homing: bool = False

    @property
    def is_busy(self) -> bool:
        """Whether a motion is under way."""
        return self._goal_m is not None

    def start_move(self, request: HandMoveRequest) -> bool:
        """Begin to go to a width; return whether the request is possible."""
        if not (0 <= request.width_m <= self.max_width_m and request.speed_m_s > 0):
            return False
        self._begin(request.width_m, request.speed_m_s)
        return True

    def start_grasp(self, request: GraspRequest) -> bool:
        """Begin to close until something is held; return whether the request is possible."""
        if not (0 <= request.width_m <= self.max_width_m and request.speed_m_s > 0 and request.force_N > 0):
            return False
        self._begin(0.0, request.speed_m_s)
        self._grasp = request
        return True

    def start_homing(self) -> None:
        """Begin to close and to open fully, which measures the widest opening."""
        self._begin(0.0, HOMING_SPEED_m_s)
        self._homing = True

    def stop(self) -> None:
        """Stop where the fingers are."""
        self._goal_m, self._grasp, self._homing = None, None, False

    def slip(self) -> None:
        """Lose what is held: the fingers close on nothing."""
        self._begin(0.0, HOMING_SPEED_m_s)
        self.object_m = 0.0

    def _begin(self, goal_m: float, speed_m_s: float) -> None:
        self.stop()
        self._goal_m, self._speed_m_s = goal_m, speed_m_s
        self.is_grasped, self.force_N = False, 0.0

    def advance(self, dt_s: float) -> HandStatus | None:
        """Move for ``dt_s``; return the motion's outcome when it ends, None otherwise."""
        if self._goal_m is None:
            return None
        step = self._speed_m_s * dt_s
        goal = max(self._goal_m, self.object_m if self.width_m >= self.object_m - ARRIVED_m else 0.0)
        self.width_m += min(max(goal - self.width_m, -step), step)
        if abs(self.width_m - goal) > ARRIVED_m:
            return None
        return self._arrive()

    def _arrive(self) -> HandStatus | None:
        if self._homing and self._goal_m == 0.0:
            self._goal_m = MAX_WIDTH_m  # the way back
            return None
        goal, grasp = self._goal_m or 0.0, self._grasp
        self.stop()
        if grasp is None:
            return HandStatus.SUCCESS if abs(goal - self.width_m) < ARRIVED_m else HandStatus.UNSUCCESSFUL
        touches = self.object_m > 0 and self.width_m <= self.object_m + ARRIVED_m
        inside = grasp.width_m - grasp.inner_m < self.width_m < grasp.width_m + grasp.outer_m
        self.is_grasped = touches and inside
        self.force_N = grasp.force_N if self.is_grasped else 0.0
        return HandStatus.SUCCESS if self.is_grasped else HandStatus.UNSUCCESSFUL
