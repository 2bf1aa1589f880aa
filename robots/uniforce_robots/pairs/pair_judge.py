"""Estimate a pair's distance from equilibrium: from images, the hand's motion and the mass.

Three sources, each for what it measures best:

- *shear* from touch: it shows a difference of a few per cent of the load, once the session's own
  pairs have shown how the two units' shears compare;
- *normal difference* from mass × acceleration of the hand along the closing axis; touch overrules
  it only where both normals disagree by far more than they did in the session so far;
- *a finger that is not touching* from touch.

How two units' normals compare depends on the object and the place. Every grasp shows it anew: while
the fingers close with the hand at rest, both pads carry the same growing force.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from uniforce_robots.pairs.rig import CLOSING

# Threshold and trust were set on simulated sessions other than those the score is measured on.
# estimated error above which a pair is flagged; above the true limit of 0.10, since noise only adds
LIMIT = 0.115
# standard deviations of the session by which normals must disagree to overrule the acceleration
TRUST = 3.0
SMOOTH = 3  # frames of the moving mean of forces; odd
ALONE = 0.3  # share of the other finger's normal below which a finger counts as not touching
# a hand below both is at rest
REST_SPEED_m_s = 0.02
REST_ACCELERATION_m_s2 = 0.6
# of the log ratio of normals, expected of a session that has not shown its own yet
FIRST_SPREAD = 0.2
GRASPS_KEPT = 48  # the newest, from which a session's comparison is learnt
# below this mean force errors count against it: a tenth of a newton is not worth a flag
FLOOR_N = 1.0
TOUCH_N = 1.0  # lighter normals say nothing of how two units compare
LEAST_N = 0.05  # keeps logarithms finite
# prior that two units' shears are alike, not made of normals: some ten grasps
PULL_N2 = (200.0, 200.0, 2000.0)
SPREAD_GRASPS = 4  # grasps the first guess of the spread is worth


@dataclass(frozen=True)
class GraspSignals:
    """One grasp so far, T frames, as the rig knows it."""

    left_N: np.ndarray  # (T, 3) estimated force on the left pad, canonical frame
    right_N: np.ndarray  # (T, 3) estimated force on the right pad
    velocity_m_s: np.ndarray  # (T, 3) of the hand in its own frame
    acceleration_m_s2: np.ndarray  # (T, 3) of the hand in its own frame
    mass_kg: float  # of object and moving holder


@dataclass(frozen=True)
class PairQuality:
    """The score of T pairs."""

    # (T,) estimated ‖F_left − F_right‖ over the mean of both; 2 where one finger doesn't touch
    error: np.ndarray

    @property
    def flagged(self) -> np.ndarray:
        """(T,) bool, not to be trained on."""
        return self.error > LIMIT


class _Compared(NamedTuple):
    """One grasp's smoothed forces (T, 3), and both normals (T,), comparable."""

    left_N: np.ndarray
    right_N: np.ndarray
    left_normal: np.ndarray
    right_normal: np.ndarray


class PairJudge:
    """Score a session's grasps in turn, and learn from each how the units compare, unlabelled."""

    def __init__(self) -> None:
        self._shear = np.eye(3, 2)  # takes the right finger's force to the left finger's shear
        self._log_ratio = 0.0  # of normals, right over left, of the session's median grasp
        # of that within a grasp, once the grasp's own comparison is taken out
        self._spread = FIRST_SPREAD
        self._grasps: list[GraspSignals] = []

    def judge(self, grasp: GraspSignals) -> PairQuality:
        """Return the score of each frame of a grasp, which may still go on."""
        c = self._compared(grasp)
        inertial = grasp.mass_kg * grasp.acceleration_m_s2[:, CLOSING]
        touch = c.left_normal - c.right_normal
        uncertainty = self._spread * (c.left_normal + c.right_normal) / 2 + LEAST_N
        difference = np.where(np.abs(touch - inertial) > TRUST * uncertainty, touch, inertial)
        shear = c.right_N @ self._shear  # (T, 2)
        apart = np.hypot(np.linalg.norm(c.left_N[:, :2] - shear, axis=1), difference)
        mean = (_size(c.left_N[:, :2], c.left_normal) + _size(shear, c.right_normal)) / 2
        weaker, stronger = np.sort([c.left_normal, c.right_normal], axis=0)
        one_alone = (weaker < ALONE * stronger) & (stronger > 0.4)
        return PairQuality(np.where(one_alone, 2.0, apart / np.maximum(mean, FLOOR_N)))

    def learn(self, grasp: GraspSignals) -> None:
        """Take a finished grasp into the session's comparison, unless nothing was touched."""
        if np.minimum(grasp.left_N[:, 2], grasp.right_N[:, 2]).max() < TOUCH_N:
            return
        self._grasps = [*self._grasps, grasp][-GRASPS_KEPT:]
        left = np.concatenate([_smooth(g.left_N) for g in self._grasps])
        self._shear = _compare_shear(
            left, np.concatenate([_smooth(g.right_N) for g in self._grasps])
        )
        known = [ratio for ratio in map(_rest_ratio, self._grasps) if np.isfinite(ratio)]
        self._log_ratio = float(np.median(known)) if known else 0.0
        self._spread = self._learn_spread()

    def _compared(self, grasp: GraspSignals) -> _Compared:
        """Make the right normal comparable by the grasp's own closing."""
        left = _smooth(grasp.left_N)
        right = _smooth(grasp.right_N)
        a = np.maximum(left[:, 2], LEAST_N)
        b = np.maximum(right[:, 2], LEAST_N)
        weight = _rest(grasp) * np.clip(np.minimum(a, b), 0, 3)
        around = np.average(np.log(a), weights=weight + 1e-6)
        terms = np.column_stack([np.ones_like(a), np.log(a) - around])
        # as if from one, four frames
        prior = np.array([self._log_ratio, 0.0])
        pull = np.diag([1.0, 4.0])
        normal = terms.T @ (weight[:, None] * terms) + pull
        found = np.linalg.solve(normal, terms.T @ (weight * np.log(b / a)) + pull @ prior)
        # a factor of 2: more is a finger not touching
        found[0] = np.clip(found[0], prior[0] - 0.7, prior[0] + 0.7)
        return _Compared(left, right, a, b * np.exp(-terms @ found))

    def _learn_spread(self) -> float:
        """Return the spread of the normals' log ratio while guided, mixed with the first guess."""
        deviations = []
        for grasp in self._grasps:
            c = self._compared(grasp)
            guided = ~_rest(grasp) & (c.left_normal > TOUCH_N)
            deviations.append(np.abs(np.log(c.right_normal / c.left_normal))[guided])
        seen = np.concatenate(deviations)
        if not len(seen):
            return FIRST_SPREAD
        own = 1.4826 * float(np.median(seen)) + 0.02
        grasps = len(self._grasps)
        return float(
            np.sqrt((SPREAD_GRASPS * FIRST_SPREAD**2 + grasps * own**2) / (SPREAD_GRASPS + grasps))
        )


def _rest(grasp: GraspSignals) -> np.ndarray:
    """Return (T,) the frames from the first touch until the hand moves for two in a row.

    On a robot a grasp begins as the fingers open after the one before, and the open hand is led to
    the next place first.
    """
    touched = np.maximum(grasp.left_N[:, 2], grasp.right_N[:, 2]) > TOUCH_N / 2
    first = int(np.argmax(touched))  # 0 where nothing is touched
    fast = np.linalg.norm(grasp.velocity_m_s, axis=1) > REST_SPEED_m_s
    moving = fast | (np.linalg.norm(grasp.acceleration_m_s2, axis=1) > REST_ACCELERATION_m_s2)
    twice = (moving & np.append(moving[1:], True))[first:]
    length = int(np.argmax(twice)) if twice.any() else len(twice)
    frame = np.arange(len(moving))
    return (frame >= first) & (frame < first + max(length, 3))


def _rest_ratio(grasp: GraspSignals) -> float:
    """Return the log ratio of normals at rest; NaN where too little touches."""
    touching = _rest(grasp) & (np.minimum(grasp.left_N[:, 2], grasp.right_N[:, 2]) > TOUCH_N)
    if touching.sum() < 3:
        return np.nan
    return float(np.median(np.log(grasp.right_N[touching, 2] / grasp.left_N[touching, 2])))


def _smooth(force_N: np.ndarray) -> np.ndarray:
    return uniform_filter1d(force_N, SMOOTH, axis=0, mode="nearest")


def _size(shear: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return np.hypot(np.linalg.norm(shear, axis=1), normal)


def _compare_shear(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return (3, 2) that takes the right force to the left shear, robust to unbalanced pairs.

    Least squares with Cauchy weights, from the identity on and pulled towards it: otherwise a
    session that begins with a bad grasp learns that grasp.
    """
    touching = np.minimum(left[:, 2], right[:, 2]) > TOUCH_N / 2
    left = left[touching]
    right = right[touching]
    size = np.linalg.norm(left, axis=1)
    noise = 0.1 + 0.04 * size
    importance = 1 / (0.5 + 0.05 * size) ** 2
    identity = np.eye(3, 2)
    pull = np.diag(PULL_N2)
    found = identity.copy()
    for axis in range(2):
        solution = identity[:, axis]
        for _ in range(15):
            weight = importance / (1 + ((left[:, axis] - right @ solution) / (1.5 * noise)) ** 2)
            scaled = right * weight[:, None]
            wanted = scaled.T @ left[:, axis] + pull @ identity[:, axis]
            solution = np.linalg.solve(scaled.T @ right + pull, wanted)
        found[:, axis] = solution
    return found
