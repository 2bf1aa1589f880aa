"""The few directions of a pooled latent on which all sensors agree: what fingers of one grasp share, and no more.

Fingers of a simulated grasp share its force; their torsion, their sensors and units differ. Directions along which
grasps differ much and fingers of one grasp little hold that force (a linear discriminant: Rao 1948, "The utilization
of multiple measurements in problems of biological classification"). A policy that hears only those can't lean on what
its own sensor alone tells. No force label is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

MOST = 16  # directions kept; beyond these fingers of one grasp differ as much as grasps do
FLOOR = 1e-3  # of the mean disagreement, added to all: numbers nobody varies must not look agreed upon


@dataclass(frozen=True)
class AgreedDirections:
    """Directions by falling agreement.

    Attributes:
        matrix: (n, MOST) so that latents @ matrix have spread 1 over grasps.
        origin: (MOST,) what free air shows.
        ratios: (MOST,) variance between grasps over variance within a grasp.
    """

    matrix: np.ndarray
    origin: np.ndarray
    ratios: np.ndarray

    @property
    def disagreement(self) -> np.ndarray:
        """(MOST,) spread of what fingers of one grasp say along each direction, where grasps have a spread of 1."""
        return 1 / np.sqrt(self.ratios)


def agreed_directions(fingers: Sequence[np.ndarray], rests: Sequence[np.ndarray]) -> AgreedDirections:
    """Return the directions.

    Args:
        fingers: latents (N, n) of the same N grasps, one array per finger and sensor; at least two.
        rests: latents (n,) in free air, one per sensor.
    """
    told = np.stack(fingers).astype(np.float64)  # (F, N, n)
    grasp = told.mean(axis=0)  # (N, n)
    own = told - grasp
    within = np.einsum("fgi,fgj->ij", own, own) / (own.shape[1] * (own.shape[0] - 1))
    between = np.cov(grasp.T)
    size = within.shape[0]
    within += FLOOR * np.trace(within) / size * np.eye(size)
    ratios, vectors = eigh(between, within)  # rising; vectors' · within · vectors = 1
    order = np.argsort(ratios)[::-1][: min(MOST, size)]
    matrix = vectors[:, order] / np.sqrt(ratios[order])
    return AgreedDirections(matrix, np.mean(rests, axis=0) @ matrix, ratios[order])
