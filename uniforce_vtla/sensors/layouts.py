"""Marker layouts: where markers sit on an undeformed pad, in mm, x right and y down, centred."""

import numpy as np


def rectangular(rows: int, columns: int, pitch_mm: tuple[float, float]) -> np.ndarray:
    """Return (rows·columns, 2) positions of a centred grid, row by row from the top left."""
    x = (np.arange(columns) - (columns - 1) / 2) * pitch_mm[0]
    y = (np.arange(rows) - (rows - 1) / 2) * pitch_mm[1]
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).astype(np.float32)


def hexagonal(rings: int, pitch_mm: float) -> np.ndarray:
    """Return (1 + 3·rings·(rings + 1), 2) positions of a hexagonal pattern; 6 rings give 127."""
    points = [
        (pitch_mm * (q + r / 2), pitch_mm * r * np.sqrt(3) / 2)
        for q in range(-rings, rings + 1)
        for r in range(-rings, rings + 1)
        if abs(q + r) <= rings
    ]
    return np.asarray(points, dtype=np.float32)


def turned(points_mm: np.ndarray, angle_rad: float) -> np.ndarray:
    """Return (M, 2) points turned about the pad's centre, x towards y."""
    cos = np.cos(angle_rad)
    sin = np.sin(angle_rad)
    return points_mm @ np.array([[cos, sin], [-sin, cos]])


def staggered(rows: int, columns: int, pitch_mm: tuple[float, float]) -> np.ndarray:
    """Return a centred grid whose odd rows are shifted by half a pitch and one marker shorter."""
    y = (np.arange(rows) - (rows - 1) / 2) * pitch_mm[1]
    points = []
    for row in range(rows):
        count = columns - row % 2
        points += [((i - (count - 1) / 2) * pitch_mm[0], y[row]) for i in range(count)]
    return np.asarray(points, dtype=np.float32)
