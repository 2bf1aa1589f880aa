"""From a rig's force axes to ours: a signed permutation, stated per data set and checked where the data allow it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.errors import ContractError, DatasetError, expected

CLEAR_PULL_N = 2.0  # a pad can't be pulled; tare drift and gel that sticks stay below this


@dataclass(frozen=True)
class ForceAxes:
    """Which recorded axis, with which sign, is each of ours.

    The default is GenForce's: Fz is negative in compression (its labels are normalised from −20 N to 5 N), Fx and
    Fy are taken as image right and image down. How a rig's shear axes lie in the image is documented for no
    public set: ``readers.shear_agreement`` tells from the data whether the signs are right.

    Attributes:
        x: recorded axis that points to the right in the image, e.g. "+x" or "-y".
        y: recorded axis that points down in the image.
        z: recorded axis that is positive in compression.
    """

    x: str = "+x"
    y: str = "+y"
    z: str = "-z"

    def __post_init__(self) -> None:
        """Raise ContractError unless the three are signed and different."""
        names = (self.x, self.y, self.z)
        if any(len(n) != 2 or n[0] not in "+-" for n in names) or {n[1] for n in names} != set("xyz"):
            do = 'Give each recorded axis once, with its sign, e.g. ForceAxes("+x", "-y", "-z").'
            raise ContractError(expected("force axes", "±x, ±y, ±z in some order", names, do))

    def to_image(self, recorded_N: np.ndarray) -> np.ndarray:
        """Return (T, 3) float32 forces in our axes from (T, 3 or more) recorded ones; moments are left aside."""
        names = (self.x, self.y, self.z)
        columns = ["xyz".index(name[1]) for name in names]
        signs = np.array([1.0 if name[0] == "+" else -1.0 for name in names])
        return (recorded_N[:, columns] * signs).astype(np.float32)  # (T, 3)


def check_compression(force_N: np.ndarray, where: str) -> None:
    """Raise DatasetError where a trial's strongest normal force is a clear pull: then z has the wrong sign."""
    strongest_pull, strongest_push = -float(force_N[:, 2].min()), float(force_N[:, 2].max())
    if strongest_pull > max(strongest_push, CLEAR_PULL_N):
        came = f"{strongest_pull:.1f} N of pull, {max(strongest_push, 0):.1f} N of compression"
        do = "Turn the sign of z in ForceAxes, or is another axis the normal?"
        raise DatasetError(expected(f"{where}, force", "compression positive in z", came, do))
