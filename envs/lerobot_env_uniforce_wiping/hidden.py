"""Hidden from every camera: a slow pull on the hand, and a board that is not quite flat.

Both are Gaussian noise, smoothed by a Gaussian and clipped at two standard deviations. The pull
stands for the unknowns of a torque-controlled arm: cables, joint friction, model errors.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d, map_coordinates

CLIP_sd = 2.0
GRID_m = 0.002  # spacing of the board's heights
BOARD_HALF_m = (0.085, 0.115)  # half extents of the board, along its x and y


@dataclass(frozen=True)
class PullSettings:
    """A force on the hand that changes slowly."""

    sd_N: float = 3.0  # per axis
    smoothing_s: float = 0.8  # standard deviation of the smoothing


@dataclass(frozen=True)
class UnevenSettings:
    """Height of the board under the eraser, over the plane."""

    sd_m: float = 0.00085
    length_m: float = 0.030  # the heights' correlation is exp(-d² / 2 length²)


def hand_pull(seed: int, settings: PullSettings, steps: int, hz: float) -> np.ndarray:
    """Return the (steps, 3) force on the hand in N, robot base frame. It repeats without a jump."""
    sigma = settings.smoothing_s * hz
    noise = np.random.default_rng([seed, 712]).standard_normal((steps, 3))
    smooth = gaussian_filter1d(noise, sigma, axis=0, mode="wrap")
    return settings.sd_N * _clipped(smooth * np.sqrt(2 * sigma * np.sqrt(np.pi)))


class UnevenBoard:
    """A random height field; ``height_m`` reads it at a place on the board."""

    def __init__(self, seed: int, settings: UnevenSettings) -> None:
        sigma = settings.length_m / np.sqrt(2) / GRID_m
        shape = [round(2 * half / GRID_m) + 1 for half in BOARD_HALF_m]
        noise = np.random.default_rng([seed, 713]).standard_normal(shape)
        smooth = gaussian_filter(noise, sigma, mode="wrap") * 2 * sigma * np.sqrt(np.pi)
        self._height_m = settings.sd_m * _clipped(smooth)

    def height_m(self, place_m: np.ndarray) -> float:
        """Return the height at (2,) x, y in board coordinates, beyond its edge the edge's."""
        index = (place_m + BOARD_HALF_m) / GRID_m
        return float(map_coordinates(self._height_m, index[:, None], order=1, mode="nearest")[0])


def _clipped(unit: np.ndarray) -> np.ndarray:
    return np.clip(unit, -CLIP_sd, CLIP_sd)
