"""Objects that press: 18 named indenters as height maps, and the flat face of a held tool.

Names follow the 18 GenForce indenters; the shapes are our own formulas, sized to press a 25 mm pad.
A height is how far the surface lies behind the foremost point, ``inf`` beyond the body.
"""

from collections.abc import Callable, Sequence

import numpy as np

from uniforce_vtla.contact.pads import GRID_CELLS, cell_positions_mm
from uniforce_vtla.errors import ContractError, expected

# (x, y) mm in the indenter's frame → height mm
Height = Callable[[np.ndarray, np.ndarray], np.ndarray]

_HALF_MM = 5.0  # typical half-width of an indenter


def _within(inside: np.ndarray, height: np.ndarray | float = 0.0) -> np.ndarray:
    return np.where(inside, height, np.inf)


def _ball(radius_mm: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    r2 = x**2 + y**2
    return _within(r2 <= radius_mm**2, radius_mm - np.sqrt(np.maximum(radius_mm**2 - r2, 0)))


def _disc(radius_mm: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return _within(x**2 + y**2 <= radius_mm**2)


def _polygon(sides: int, apothem_mm: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    angles = np.arange(sides) * 2 * np.pi / sides + np.pi / 2
    reach = np.max([x * np.cos(a) + y * np.sin(a) for a in angles], axis=0)
    return _within(reach <= apothem_mm)


def _bar(half_length_mm: float, radius_mm: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.where(np.abs(x) <= half_length_mm, _ball(radius_mm, np.zeros_like(x), y), np.inf)


def _random(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A fixed rough relief: a few waves of unrelated direction and length."""
    waves = ((0.9, 0.3, 0.2), (-0.4, 0.8, 1.7), (0.6, -1.1, 4.0), (1.3, 0.7, 2.9))
    relief = np.sum([np.sin(a * x + b * y + c) for a, b, c in waves], axis=0)
    return _within(np.maximum(np.abs(x), np.abs(y)) <= _HALF_MM, 0.3 * (4 - relief))


_CORNERS = tuple((a, b) for a in (-3.5, 3.5) for b in (-3.5, 3.5))

HEIGHTS: dict[str, Height] = {
    "cone": lambda x, y: _within(np.hypot(x, y) <= 6.0, np.hypot(x, y) * 0.6),
    "cylinder": lambda x, y: _disc(_HALF_MM, x, y),
    # a shell
    "cylinder_sh": lambda x, y: _within((np.hypot(x, y) <= _HALF_MM) & (np.hypot(x, y) >= 3.0)),
    "cylinder_si": lambda x, y: _bar(6.0, 4.0, x, y),  # lying on its side
    # a disc with one blunt dot standing out of its middle
    "dotin": lambda x, y: np.minimum(_ball(2.0, x, y), _disc(_HALF_MM, x, y) + 1.0),
    "dots": lambda x, y: np.min(
        [_ball(1.8, x - a, y - b) for a, b in (*_CORNERS, (0.0, 0.0))], axis=0
    ),
    "hemisphere": lambda x, y: _ball(_HALF_MM, x, y),
    "hexagon": lambda x, y: _polygon(6, 4.5, x, y),
    "line": lambda x, y: _bar(7.0, 1.5, x, y),
    "moon": lambda x, y: _within((np.hypot(x, y) <= _HALF_MM) & (np.hypot(x - 2.5, y) >= 4.0)),
    "pacman": lambda x, y: _within(
        (np.hypot(x, y) <= _HALF_MM) & (np.abs(np.arctan2(y, x)) >= np.pi / 5)
    ),
    "prism": lambda x, y: _within((np.abs(x) <= _HALF_MM) & (np.abs(y) <= 4.0), np.abs(y) * 0.8),
    "random": _random,
    "sphere": lambda x, y: _ball(7.0, x, y),
    "sphere_s": lambda x, y: _ball(3.5, x, y),
    "torus": lambda x, y: _ball(1.8, np.hypot(x, y) - 4.0, np.zeros_like(x)),
    "triangle": lambda x, y: _polygon(3, 3.0, x, y),
    "wave": lambda x, y: _within(
        (np.abs(x) <= 6.0) & (np.abs(y) <= 4.0), 0.6 * (1 - np.cos(x * np.pi / 2.0))
    ),
}
UNSEEN = ("sphere_s", "triangle", "pacman", "cone", "wave", "torus")
SEEN = tuple(name for name in HEIGHTS if name not in UNSEEN)
PRETRAIN = ("cylinder", "cylinder_si", "dotin", "hexagon", "line", "moon", "prism", "sphere")


def gap_map(
    name: str, center_mm: Sequence[float], angle_rad: float, scale: float = 1.0
) -> np.ndarray:
    """Return (G, G) float32 gap of one indenter: foremost point at 0, ``inf`` beyond its body."""
    return gap_maps([name], np.array([center_mm]), np.array([angle_rad]), np.array([scale]))[0]


def gap_maps(
    names: Sequence[str], center_mm: np.ndarray, angle_rad: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Return (B, G, G) float32 gaps at (B, 2) centres, turned by (B,) angles, sized by (B,) scales.

    Raises ContractError: unknown indenter.
    """
    return _map(indenter_gap(names, center_mm, angle_rad, scale, cell_positions_mm()))


def indenter_gap(
    names: Sequence[str],
    center_mm: np.ndarray,
    angle_rad: np.ndarray,
    scale: np.ndarray,
    position_mm: np.ndarray,
) -> np.ndarray:
    """Return (B, N) gaps as ``gap_maps`` does, at any (N, 2) positions on the pad."""
    unknown = sorted(set(names) - set(HEIGHTS))
    if unknown:
        raise ContractError(
            expected("indenter", " | ".join(HEIGHTS), unknown, "Check the spelling.")
        )
    x, y = _local(center_mm, angle_rad, position_mm)
    scale = np.asarray(scale, dtype=np.float64)[:, None]
    gap = np.empty_like(x)
    for name in dict.fromkeys(names):
        rows = np.flatnonzero(np.asarray(names) == name)
        gap[rows] = HEIGHTS[name](x[rows] / scale[rows], y[rows] / scale[rows]) * scale[rows]
    return _grounded(gap)


def flat_face_gap(
    center_mm: np.ndarray, size_mm: np.ndarray, angle_rad: np.ndarray, tilt_rad: np.ndarray
) -> np.ndarray:
    """Return (B, G, G) float32 gap of a rectangular flat face, e.g. the side of a held eraser.

    Args:
        center_mm: (B, 2) face centre in the pad frame.
        size_mm: (B, 2) extent along the face's own x and y.
        angle_rad: (B,) rotation in the pad plane, x towards y.
        tilt_rad: (B, 2) slope of the gap along pad x and y; positive opens towards +x, +y.
    """
    return _map(flat_gap(center_mm, size_mm, angle_rad, tilt_rad, cell_positions_mm()))


def flat_gap(
    center_mm: np.ndarray,
    size_mm: np.ndarray,
    angle_rad: np.ndarray,
    tilt_rad: np.ndarray,
    position_mm: np.ndarray,
) -> np.ndarray:
    """Return (B, N) gaps as ``flat_face_gap`` does, at any (N, 2) positions on the pad."""
    x, y = _local(center_mm, angle_rad, position_mm)
    half = np.asarray(size_mm)[:, None] / 2  # (B, 1, 2)
    inside = (np.abs(x) <= half[..., 0]) & (np.abs(y) <= half[..., 1])
    return _grounded(np.where(inside, np.tan(np.asarray(tilt_rad)) @ position_mm.T, np.inf))


def _local(
    center_mm: np.ndarray, angle_rad: np.ndarray, position_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions as (B, N) x and y in each object's own frame."""
    arm = position_mm[None] - np.asarray(center_mm)[:, None]
    cos = np.cos(angle_rad)[:, None]
    sin = np.sin(angle_rad)[:, None]
    return cos * arm[..., 0] + sin * arm[..., 1], cos * arm[..., 1] - sin * arm[..., 0]


def _grounded(gap: np.ndarray) -> np.ndarray:
    """Shift (B, N) so that the point that touches first is at 0; no object stays ``inf``."""
    first = gap.min(axis=1, keepdims=True)
    return gap - np.where(np.isfinite(first), first, 0)


def _map(gap: np.ndarray) -> np.ndarray:
    return gap.reshape(-1, GRID_CELLS, GRID_CELLS).astype(np.float32)
