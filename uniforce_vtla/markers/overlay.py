"""How markers moved, in one picture."""

import numpy as np


def overlay(reference: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) uint8: markers where they were cyan, where they are red, where both white; on black."""
    return np.stack([current, reference, reference], axis=-1)
