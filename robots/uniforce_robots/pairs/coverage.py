"""Forces that a session has covered so far, and those still missing.

Forces are estimates of the readers that score the pairs. They steer an operator and label nothing.
"""

import numpy as np

NORMAL_EDGES_N = (0.0, 2.0, 4.0, 6.0, 9.0, 12.0)  # the paper's range, finer where grasps are gentle
SHEAR_EDGES_N = (0.0, 0.5, 1.5, 3.0)  # magnitude
ENOUGH = 10  # pairs in a cell that make it covered


class Coverage:
    """Counts of kept pairs: ``force`` by (normal, shear); empty at first."""

    def __init__(self) -> None:
        self.force = np.zeros((len(NORMAL_EDGES_N) - 1, len(SHEAR_EDGES_N) - 1), int)

    def add(self, force_N: np.ndarray) -> None:
        """Count pairs by their (N, 3) forces; what lies beyond an edge counts in the last cell."""
        for force in force_N:
            self.force[self.cell(force)] += 1

    @staticmethod
    def cell(force_N: np.ndarray) -> tuple[int, int]:
        """Return (normal, shear) cell of a force (3,)."""
        pull = float(np.linalg.norm(force_N[:2]))
        return _bin(float(force_N[2]), NORMAL_EDGES_N), _bin(pull, SHEAR_EDGES_N)

    @property
    def covered(self) -> float:
        """Share of the force cells that hold ``ENOUGH`` pairs."""
        return float((self.force >= ENOUGH).mean())

    def missing(self) -> str:
        """Say in words which force cell holds least."""
        normal, shear = np.unravel_index(int(self.force.argmin()), self.force.shape)
        edges_N = *NORMAL_EDGES_N[normal : normal + 2], *SHEAR_EDGES_N[shear : shear + 2]
        return "grip {:g}–{:g} N, pull {:g}–{:g} N".format(*edges_N)


def _bin(value: float, edges: tuple[float, ...]) -> int:
    return int(np.digitize(value, edges[1:-1]))
