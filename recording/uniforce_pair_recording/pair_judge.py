"""How far a pair is from equilibrium, from what a rig has: two tactile images, the hand's motion, the object's mass.

The truth is never used. Three sources, each trusted for what it tells best:

- *shear* from the touch: a difference of a few per cent of the load shows, once the session's own pairs have told how
  the two units' shears compare;
- *normal difference* from the hand's acceleration along the closing axis, mass × acceleration; the touch overrules it
  only where both fingers' normals disagree by far more than they did in the session so far;
- *a finger that is not touching* from the touch.

How two units' normals compare depends on what is held and where, so every grasp brings its own answer: while the
fingers close with the hand at rest, both pads carry the same growing force.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from uniforce_pair_recording.guided_grasp import CLOSING

FLOOR_N = 1.0  # below this mean force errors count against it: a tenth of a newton is not worth a flag
TOUCH_N = 1.0  # lighter normals tell nothing of how two units compare
LEAST_N = 0.05  # keeps logarithms finite
PULL_N2 = (
    200.0,
    200.0,
    2000.0,
)  # belief that two units' shears are alike, and not made of normals: some ten grasps
SPREAD_GRASPS = 4  # grasps the first guess of the spread is worth


@dataclass(frozen=True)
class JudgeSettings:
    """Numbers of the score; threshold and trust were set on simulated sessions other than those it is scored on.

    Attributes:
        limit: estimated error above which a pair is flagged. Above the true limit of 0.10, since noise only adds.
        trust: how many of the session's own standard deviations the normals must disagree to overrule the acceleration.
        smooth: frames of the moving mean of forces; odd.
        alone: share of the other finger's normal below which a finger counts as not touching.
        rest_speed_m_s, rest_acceleration_m_s2: a hand below both is at rest.
        first_spread: of the log ratio of normals, expected of a session that has not shown its own yet.
        grasps_kept: from which a session's comparison is learnt; the newest.
    """

    limit: float = 0.115
    trust: float = 3.0
    smooth: int = 3
    alone: float = 0.3
    rest_speed_m_s: float = 0.02
    rest_acceleration_m_s2: float = 0.6
    first_spread: float = 0.2
    grasps_kept: int = 48


@dataclass(frozen=True)
class GraspSignals:
    """What a rig knows of one grasp so far, T frames.

    Attributes:
        left_N, right_N: (T, 3) estimated forces, canonical frame.
        velocity_m_s, acceleration_m_s2: (T, 3) of the hand in its own frame.
        mass_kg: of object and moving holder.
    """

    left_N: np.ndarray
    right_N: np.ndarray
    velocity_m_s: np.ndarray
    acceleration_m_s2: np.ndarray
    mass_kg: float


@dataclass(frozen=True)
class PairQuality:
    """The score of T pairs.

    Attributes:
        error: (T,) estimated ‖F_left − F_right‖ over the mean of both; 2 where one finger doesn't touch.
        flagged: (T,) bool, not to be trained on.
    """

    error: np.ndarray
    flagged: np.ndarray


@dataclass
class Comparison:
    """How a session's two units compare, learnt from its own grasps without any label.

    Attributes:
        shear: (3, 2) takes the right finger's force to the left finger's shear.
        log_ratio: of normals, right over left, of the session's median grasp.
        spread: standard deviation of that within a grasp, once the grasp's own comparison is taken out.
    """

    shear: np.ndarray = field(default_factory=lambda: np.eye(3, 2))
    log_ratio: float = 0.0
    spread: float = 0.2


class PairJudge:
    """Scores a session's grasps one after the other, and learns from each how the units compare."""

    def __init__(self, settings: JudgeSettings | None = None) -> None:
        self.settings = settings or JudgeSettings()
        self.comparison = Comparison(spread=self.settings.first_spread)
        self._grasps: list[GraspSignals] = []

    def judge(self, grasp: GraspSignals) -> PairQuality:
        """Return the score of each frame of a grasp, which may still go on."""
        s = self.settings
        left, right, normals = self._compared(grasp)
        inertial = grasp.mass_kg * grasp.acceleration_m_s2[:, CLOSING]
        felt = normals.left - normals.right
        doubt = self.comparison.spread * (normals.left + normals.right) / 2 + LEAST_N
        difference = np.where(np.abs(felt - inertial) > s.trust * doubt, felt, inertial)
        shear = right @ self.comparison.shear  # (T, 2)
        apart = np.hypot(np.linalg.norm(left[:, :2] - shear, axis=1), difference)
        mean = (_size(left[:, :2], normals.left) + _size(shear, normals.right)) / 2
        error = np.where(self._one_alone(normals), 2.0, apart / np.maximum(mean, FLOOR_N))
        return PairQuality(error, error > s.limit)

    def learn(self, grasp: GraspSignals) -> None:
        """Take a finished grasp into the session's comparison."""
        self._grasps = [*self._grasps, grasp][-self.settings.grasps_kept :]
        smoothed = [(self._smooth(g.left_N), self._smooth(g.right_N)) for g in self._grasps]
        left, right = (np.concatenate(side) for side in zip(*smoothed, strict=True))
        self.comparison.shear = _compare_shear(left, right)
        ratios = [self._rest_ratio(g) for g in self._grasps]
        known = [ratio for ratio in ratios if np.isfinite(ratio)]
        self.comparison.log_ratio = float(np.median(known)) if known else 0.0
        self.comparison.spread = self._spread()

    # --- inside ------------------------------------------------------------------------------------------------------

    def _compared(self, grasp: GraspSignals) -> tuple[np.ndarray, np.ndarray, _Normals]:
        left, right = self._smooth(grasp.left_N), self._smooth(grasp.right_N)
        return left, right, self._normals(left, right, self._rest(grasp))

    def _normals(self, left: np.ndarray, right: np.ndarray, rest: np.ndarray) -> _Normals:
        """Return both normals (T,), the right one made comparable by the grasp's own closing."""
        a, b = np.maximum(left[:, 2], LEAST_N), np.maximum(right[:, 2], LEAST_N)
        weight = rest * np.clip(np.minimum(a, b), 0, 3)
        around = np.average(np.log(a), weights=weight + 1e-6)
        terms = np.column_stack([np.ones_like(a), np.log(a) - around])
        prior, pull = (
            np.array([self.comparison.log_ratio, 0.0]),
            np.diag([1.0, 4.0]),
        )  # as if from one, four frames
        normal = terms.T @ (weight[:, None] * terms) + pull
        found = np.linalg.solve(normal, terms.T @ (weight * np.log(b / a)) + pull @ prior)
        found[0] = np.clip(
            found[0], prior[0] - 0.7, prior[0] + 0.7
        )  # a factor of 2: more is a finger not touching
        return _Normals(a, b * np.exp(-terms @ found))

    def _rest(self, grasp: GraspSignals) -> np.ndarray:
        """(T,) the first frames, until the hand moves for two frames in a row."""
        s = self.settings
        moving = (np.linalg.norm(grasp.velocity_m_s, axis=1) > s.rest_speed_m_s) | (
            np.linalg.norm(grasp.acceleration_m_s2, axis=1) > s.rest_acceleration_m_s2
        )
        twice = moving & np.append(moving[1:], True)
        begun = int(np.argmax(twice)) if twice.any() else len(moving)
        return np.arange(len(moving)) < max(begun, 3)

    def _rest_ratio(self, grasp: GraspSignals) -> float:
        touching = self._rest(grasp) & (np.minimum(grasp.left_N[:, 2], grasp.right_N[:, 2]) > TOUCH_N)
        if touching.sum() < 3:
            return np.nan
        return float(np.median(np.log(grasp.right_N[touching, 2] / grasp.left_N[touching, 2])))

    def _spread(self) -> float:
        """Return the spread of the log ratio of normals while guided: robust, and mixed with the first guess."""
        deviations = []
        for grasp in self._grasps:
            _, _, normals = self._compared(grasp)
            guided = ~self._rest(grasp) & (normals.left > TOUCH_N)
            deviations.append(np.abs(np.log(normals.right / normals.left))[guided])
        felt, first = np.concatenate(deviations), self.settings.first_spread
        if not len(felt):
            return first
        own, grasps = 1.4826 * float(np.median(felt)) + 0.02, len(self._grasps)
        return float(np.sqrt((SPREAD_GRASPS * first**2 + grasps * own**2) / (SPREAD_GRASPS + grasps)))

    def _one_alone(self, normals: _Normals) -> np.ndarray:
        weaker, stronger = np.minimum(normals.left, normals.right), np.maximum(normals.left, normals.right)
        return (weaker < self.settings.alone * stronger) & (stronger > 0.4)

    def _smooth(self, force_N: np.ndarray) -> np.ndarray:
        reach = self.settings.smooth // 2
        padded = np.pad(force_N, ((reach, reach), (0, 0)), mode="edge")
        kernel = np.ones(self.settings.smooth) / self.settings.smooth
        return np.column_stack([np.convolve(padded[:, axis], kernel, "valid") for axis in range(3)])


@dataclass(frozen=True)
class _Normals:
    """Normal forces (T,) of both fingers, comparable."""

    left: np.ndarray
    right: np.ndarray


def _size(shear: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return np.hypot(np.linalg.norm(shear, axis=1), normal)


def _compare_shear(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return (3, 2) that takes the right force to the left shear: robust, since a part of the pairs is out of balance.

    Least squares whose rows count less the worse they fit (Cauchy weights), from the identity on and pulled towards it:
    without that, a session that begins with a bad grasp learns that grasp.
    """
    touching = np.minimum(left[:, 2], right[:, 2]) > TOUCH_N / 2
    left, right = left[touching], right[touching]
    size = np.linalg.norm(left, axis=1)
    noise, importance = 0.1 + 0.04 * size, 1 / (0.5 + 0.05 * size) ** 2
    identity, pull = np.eye(3, 2), np.diag(PULL_N2)
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
