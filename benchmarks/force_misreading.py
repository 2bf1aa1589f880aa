"""How many newtons a policy misreads: what its commands do when it is given other touch, all else the same.

A policy's commands respond to touch: more press, and it raises its next height; more grip, and it opens. The slope of
that response, found by giving it the touch of other moments, turns any change of a command into newtons.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from uniforce_vtla.errors import DatasetError, RolloutError, expected

# force → its place in a wrench and its sign there (a press is −y on both pads)
FORCES = {"press": (1, -1.0), "grip": (2, 1.0)}
LEAST_MOMENTS = 20  # fewer don't determine four slopes
PRESSING_N = 2.0  # shear along the pad's height above this is a wipe
IN_AIR_N = 1.0  # below this only the eraser's weight pulls
CLOSING_N, HELD_N = 2.0, 8.0  # grip from the first touch to about the demos' own


@dataclass(frozen=True)
class Situation:
    """When forces are asked for: what is regulated then, and which moments (by (N, 4) true wrench) are meant."""

    forces: tuple[str, ...]
    meant: Callable[[np.ndarray], np.ndarray]


def _in_air(wrench: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(wrench[:, 1]) < IN_AIR_N)


SITUATIONS = {
    "closing": Situation(("grip",), lambda w: _in_air(w) & (w[:, 2] > CLOSING_N) & (w[:, 2] < HELD_N)),
    "carrying": Situation(("grip",), lambda w: _in_air(w) & (w[:, 2] >= HELD_N)),
    "wiping": Situation(("press", "grip"), lambda w: np.abs(w[:, 1]) > PRESSING_N),
}


@dataclass(frozen=True)
class Changes:
    """What other touch did at N moments.

    Attributes:
        moves_mm: (N, 2) change of the commanded height and width.
        wrench: (N, 4) by how much the true wrench behind the new touch differs: N, N, N, Nmm.
        episode: (N,) number of each moment's episode.
    """

    moves_mm: np.ndarray
    wrench: np.ndarray
    episode: np.ndarray


@dataclass(frozen=True)
class Response:
    """How commands answer touch.

    Attributes:
        slopes: (4, 2) mm per N (per Nmm) of fx, fy, fz, torsion, for height and width.
    """

    slopes: np.ndarray

    def of(self, force: str) -> float:
        """Return mm per N of press (height) or grip (width)."""
        place, sign = FORCES[force]
        return sign * float(self.slopes[place, list(FORCES).index(force)])


@dataclass(frozen=True)
class Misreading:
    """Newtons of one force, per finger, by which a policy errs."""

    mean_N: float  # over all moments: a bias
    between_episodes_N: float  # spread of the episodes' means: what regulation can't average out
    rms_N: float  # of single moments
    slope_ratio: float  # to that of the finger it was trained with: 1 = the same response


def response(changes: Changes) -> Response:
    """Fit how commands answer a change of the wrench.

    Raises:
        DatasetError: too few moments.
    """
    if len(changes.wrench) < LEAST_MOMENTS:
        do = "Look at more episodes."
        raise DatasetError(expected("moments", f"at least {LEAST_MOMENTS}", len(changes.wrench), do))
    inputs = np.c_[changes.wrench, np.ones(len(changes.wrench))]
    slopes, *_ = np.linalg.lstsq(inputs, changes.moves_mm, rcond=None)
    return Response(slopes[:-1])


def misreading(
    same: Changes, other: Changes, learnt: Response, forces: Sequence[str] = tuple(FORCES)
) -> dict[str, Misreading]:
    """Return what a policy misreads with a finger, by force.

    Args:
        same: that finger's touch of the same moments instead of the learnt one's.
        other: that finger's touch of other moments.
        learnt: how the policy answers the finger it learnt with.
        forces: which are asked for.

    Raises:
        RolloutError: it doesn't respond to a force as a regulator would.
    """
    for force in forces:
        if not learnt.of(force) > 0:
            came, do = f"{learnt.of(force):.3f} mm per N", "Train it longer, or with touch."
            raise RolloutError(expected(f"answer to more {force}", "a command that gives way", came, do))
    answered, found = response(other), {}
    surplus_mm = same.moves_mm - same.wrench @ learnt.slopes  # the true forces of both fingers differ
    for force in forces:
        error_N = surplus_mm[:, list(FORCES).index(force)] / learnt.of(force)
        means = np.array([error_N[same.episode == one].mean() for one in np.unique(same.episode)])
        found[force] = Misreading(
            mean_N=float(error_N.mean()),
            between_episodes_N=float(means.std()),
            rms_N=float(np.sqrt(np.square(error_N).mean())),
            slope_ratio=answered.of(force) / learnt.of(force),
        )
    return found
