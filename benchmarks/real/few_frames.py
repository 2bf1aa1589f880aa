"""Correct a sensor by ten frames with a known force: its mount angle, gain and offset per axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.calibrate import in_plane_turn_rad

FEWEST = 10  # seven numbers are fitted


@dataclass(frozen=True)
class ForceCorrection:
    """Turn the shear plane, then gain · force + offset per axis; canonical frame."""

    turn_rad: float  # x towards y
    gain: np.ndarray  # (3,) x, y, z
    offset_N: np.ndarray  # (3,)

    @classmethod
    def fit(cls, read_N: np.ndarray, known_N: np.ndarray) -> ForceCorrection:
        """Return the correction that brings (n, 3) readings to known forces.

        Raises ContractError: fewer than ``FEWEST`` frames, another shape, NaN, or an axis that was
        never loaded.
        """
        if (
            read_N.shape != known_N.shape
            or read_N.ndim != 2
            or read_N.shape[1] != 3
            or len(read_N) < FEWEST
        ):
            came = f"{read_N.shape} and {known_N.shape}"
            raise ContractError(
                expected("labelled frames", f"({FEWEST} or more, 3) twice", came, "Record more.")
            )
        if not (np.isfinite(read_N).all() and np.isfinite(known_N).all()):
            raise ContractError(
                expected("labelled frames", "finite forces", "NaN or inf", "Leave them out.")
            )
        if read_N.std(axis=0).min() < 1e-6 or known_N.std(axis=0).min() < 1e-6:
            do = "Press and pull in all directions."
            raise ContractError(
                expected("labelled frames", "changing forces", "an axis never loaded", do)
            )
        turn = in_plane_turn_rad(read_N[:, :2], known_N[:, :2])
        mounted_N = turned(read_N, turn)
        lines = [np.polyfit(mounted_N[:, k], known_N[:, k], 1) for k in range(3)]
        gain, offset_N = np.transpose(lines)
        return cls(turn, gain, offset_N)

    def __call__(self, read_N: np.ndarray) -> np.ndarray:
        """Return corrected forces (n, 3) in N."""
        return turned(read_N, self.turn_rad) * self.gain + self.offset_N


def turned(force_N: np.ndarray, turn_rad: float) -> np.ndarray:
    """Return (n, 3) forces whose shear plane is turned, x towards y."""
    cos = np.cos(turn_rad)
    sin = np.sin(turn_rad)
    return np.column_stack([force_N[:, :2] @ np.array([[cos, sin], [-sin, cos]]), force_N[:, 2]])
