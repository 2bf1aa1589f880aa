"""Find how two fingers' sensors are mounted to each other, from loads that both carry.

A push on a held object pulls both pads the same way. In the canonical frame both sensors then read
the same shear. A sensor turned by 180° reads both axes with the other sign, a mirrored one reads
one axis so.

The readings don't show which of the two sensors is turned. A grasp that carries little shows
nothing either: an object that is only pinched pulls the pads *opposite* ways, as if one were
turned. Of 87 real grasps that were only lifted and shaken, 7 said "turned" and 10 "mirrored",
wrongly (docs/evidence.md).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from uniforce_vtla.errors import ContractError, expected

Mount = Literal["upright", "turned", "mirrored_x", "mirrored_y", "undecided"]
# mount → settings that bring it upright: degrees counter-clockwise, columns mirrored before
SETTINGS: dict[Mount, tuple[int, bool]] = {
    "upright": (0, False),
    "turned": (180, False),
    "mirrored_x": (0, True),
    "mirrored_y": (180, True),
}
MOUNTS: dict[tuple[bool, bool], Mount] = {  # whether x and y are read with the same sign
    (True, True): "upright",
    (False, False): "turned",
    (False, True): "mirrored_x",
    (True, False): "mirrored_y",
}
LEAST_R = 0.5  # of each axis, either sign; simulated grasps reach .94 to 1
FEWEST = 10  # readings; of fewer, chance alone reaches such an r


@dataclass(frozen=True)
class MountRelation:
    """How the first sensor is mounted if the second is upright."""

    mount: Mount
    r: tuple[float, float]  # correlation of their shear along x and y


def mount_relation(first: np.ndarray, second: np.ndarray) -> MountRelation:
    """Return how two sensors are mounted to each other.

    Args:
        first: (n, 2) shear or mean marker motion of one finger, canonical frame, in any unit.
        second: (n, 2) of the other finger at the same moments.

    Raises ContractError: readings that aren't paired or aren't finite.
    """
    shape = np.shape(first)
    if shape != np.shape(second) or len(shape) != 2 or shape[1] != 2:
        came = f"{shape} and {np.shape(second)}"
        raise ContractError(
            expected("paired shear", "(n, 2) twice", came, "Pair the readings by frame.")
        )
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        raise ContractError(
            expected("paired shear", "finite numbers", "NaN or inf", "Leave those frames out.")
        )
    if len(first) < FEWEST:
        return MountRelation("undecided", (0.0, 0.0))
    a = first - first.mean(axis=0)
    b = second - second.mean(axis=0)
    size = np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    x, y = ((a * b).sum(axis=0) / np.maximum(size, 1e-12)).tolist()
    if min(abs(x), abs(y)) < LEAST_R:
        return MountRelation("undecided", (x, y))
    return MountRelation(MOUNTS[x > 0, y > 0], (x, y))
