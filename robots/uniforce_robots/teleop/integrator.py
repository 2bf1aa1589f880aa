"""Turn speeds and wishes into an absolute target: limited in speed, boxed, on a leash.

Every teleoperator that does not simply repeat measured poses moves its target here. ``start_from``
puts the target on the measured pose; from then on it moves by at most speed × time.
"""

from dataclasses import dataclass, field

import numpy as np
from lerobot.teleoperators import TeleoperatorConfig

from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.franka.poses import shortest_turn
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import AXES

YAW = AXES.index("yaw.pos")
TINY_m = 1e-12  # a step below is none
LONGEST_GAP_S = 0.1  # a longer pause counts as this long, so that it buys no jump


@dataclass(frozen=True)
class TargetLimits:
    """How a target may move; axes as in ``keys.AXES``: x, y, z m, yaw rad, width m, base frame."""

    # per second; the robot's own guards allow 0.25 m/s, a person wants less near contact
    speed: tuple[float, ...] = (0.10, 0.10, 0.10, 0.6, 0.06)
    # the robot's own box; a start outside widens it: the start is no jump
    low: tuple[float, ...] = GuardLimits.low
    high: tuple[float, ...] = GuardLimits.high
    # How far each axis may lead the measured pose, so that a target pushed into a table does not
    # run on. 20 mm is just above the arm's clip of 18 mm, beyond which no force grows.
    leash: tuple[float, ...] = (0.02, 0.02, 0.02, 0.2, 0.03)

    def __post_init__(self) -> None:
        for name, row in vars(self).items():
            if len(row) != len(AXES) or not np.isfinite(row).all():
                do = "Give one finite number per axis."
                raise ContractError(expected(f"limits.{name}", f"{len(AXES)} numbers", row, do))
        if np.any(np.greater_equal(self.low, self.high)) or min(*self.speed, *self.leash) < 0:
            raise ContractError(
                expected(
                    "target limits", "low < high, speed and leash ≥ 0", vars(self), "Mend them."
                )
            )


@dataclass(kw_only=True)
class SteeringConfig(TeleoperatorConfig):
    """Settings of every device that moves a target."""

    # how far and fast the target may move
    limits: TargetLimits = field(default_factory=TargetLimits)


class TargetIntegrator:
    """Keep an absolute target (5,) and move it by speeds, or towards a goal."""

    def __init__(self, limits: TargetLimits | None = None) -> None:
        self.limits = limits or TargetLimits()
        self._speed = np.array(self.limits.speed)
        self._leash = np.array(self.limits.leash)
        self.start_from(np.zeros(len(AXES)))

    @property
    def target(self) -> np.ndarray:
        """(5,) the target now, a copy."""
        return self._target.copy()

    def start_from(self, measured: np.ndarray) -> None:
        """Put the target on the measured pose (5,), wherever that is."""
        self._target = np.array(measured, dtype=np.float64)
        self._low: np.ndarray = np.minimum(self.limits.low, self._target)
        self._high: np.ndarray = np.maximum(self.limits.high, self._target)

    def advance(
        self, rates: np.ndarray, elapsed_s: float, measured: np.ndarray | None = None
    ) -> np.ndarray:
        """Move the target by ``rates`` and return it.

        Args:
            rates: (5,) wanted speed of each axis as a share of its limit, clipped to −1 … 1.
            elapsed_s: since the last call.
            measured: (5,) where the robot is; None: unknown, no leash.
        """
        return self._move(np.clip(rates, -1, 1) * self._reach(elapsed_s), measured)

    def towards(
        self, goal: np.ndarray, elapsed_s: float, measured: np.ndarray | None = None
    ) -> np.ndarray:
        """Move the target towards a goal (5,) within the limits, turning the shorter way.

        The three positions keep their direction, so that a fast hand draws the same line, later.
        """
        reach = self._reach(elapsed_s)
        step = np.asarray(goal, dtype=np.float64) - self._target
        # half a turn has two ways, and one leads out of the box
        centre = (self._low[YAW] + self._high[YAW]) / 2
        inside = centre + shortest_turn(centre, float(goal[YAW]))
        step[YAW] = np.clip(inside, self._low[YAW], self._high[YAW]) - self._target[YAW]
        step[:3] *= min(1.0, np.min(reach[:3] / np.maximum(np.abs(step[:3]), TINY_m)))
        step[3:] = np.clip(step[3:], -reach[3:], reach[3:])
        return self._move(step, measured)

    def _reach(self, elapsed_s: float) -> np.ndarray:
        return self._speed * min(max(elapsed_s, 0.0), LONGEST_GAP_S)

    def _move(self, step: np.ndarray, measured: np.ndarray | None) -> np.ndarray:
        moved = np.clip(self._target + step, self._low, self._high)
        if measured is not None:
            lead = _lead(moved, measured)
            before = _lead(self._target, measured)
            runs_off = (lead > self._leash) & (lead > before)
            moved = np.where(runs_off, self._target, moved)
        self._target = moved
        return self.target


def _lead(target: np.ndarray, measured: np.ndarray) -> np.ndarray:
    lead = np.abs(target - measured)
    lead[YAW] = abs(shortest_turn(float(measured[YAW]), float(target[YAW])))
    return lead
