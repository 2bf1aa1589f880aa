"""What lies outside the procedural family: proof that held-out sensors could not have been drawn in pretraining."""

from dataclasses import fields

import numpy as np

from uniforce_vtla.contact.family import HIDDEN, FamilyBounds, Span
from uniforce_vtla.contact.materials import MATERIALS, PadMaterial
from uniforce_vtla.contact.virtual import VirtualSensor


def half_extent_px(sensor: VirtualSensor) -> np.ndarray:
    """Return (2,) how far the layout reaches from the image's centre, in pixels."""
    return np.abs(sensor.spec.layout_mm).max(axis=0) * np.asarray(sensor.spec.px_per_mm)


def outside(sensor: VirtualSensor, bounds: FamilyBounds | None = None) -> list[str]:
    """Return in which ways a camera sensor differs from everything the family can draw; empty if it could be one.

    ``visible: …`` entries show in a reference image, ``hidden: …`` do not.
    """
    b = bounds or FamilyBounds()
    spec, material = sensor.spec, sensor.material
    assert isinstance(material, PadMaterial)
    shapes = b.flat.shapes if spec.dome_radius_mm is None else ("disc",)
    found = [] if spec.marker_shape in shapes else [f"visible: marker_shape {spec.marker_shape}"]
    low, high = b.flat.px_per_mm if spec.dome_radius_mm is None else b.dome.px_per_mm
    if not low <= spec.px_per_mm[0] <= high:
        found.append(f"visible: px_per_mm {spec.px_per_mm[0]:.3g}")
    if not _is_lattice(spec.layout_mm):
        found.append("visible: layout is no lattice of the family")
    if np.any(half_extent_px(sensor) > np.array([320, 240])):
        found.append("visible: layout reaches beyond the image")
    base = MATERIALS["gelsight" if spec.dome_radius_mm is None else "tactip"]
    for name in (f.name for f in fields(PadMaterial)):
        found += _hidden_difference(name, getattr(material, name), getattr(base, name), b.material)
    return found


def _hidden_difference(name: str, value: object, base: object, spread: Span) -> list[str]:
    if name == "fisheye":  # shows in the reference
        return []
    low, high = spread if name in HIDDEN else (1.0, 1.0)
    numbers, bases = np.atleast_1d(value), np.atleast_1d(base)  # type: ignore[call-overload]
    inside = np.all((numbers >= bases * low - 1e-9) & (numbers <= bases * high + 1e-9))
    return [] if inside else [f"hidden: {name} {value} (family {base} × {low}–{high})"]


def _is_lattice(points_mm: np.ndarray) -> bool:
    """Tell rectangular or hexagonal lattices: every marker's offset is a whole number of two basis steps."""
    steps = points_mm[None] - points_mm[:, None]  # (M, M, 2)
    length = np.linalg.norm(steps, axis=-1)
    np.fill_diagonal(length, np.inf)
    nearest = steps[np.unravel_index(length.argmin(), length.shape)]
    unit = nearest / np.linalg.norm(nearest)
    across = np.abs(steps @ np.array([-unit[1], unit[0]]))
    length[across < 0.1 * np.linalg.norm(nearest)] = np.inf
    if not np.isfinite(length).any():
        return False
    second = steps[np.unravel_index(length.argmin(), length.shape)]
    basis = np.stack([nearest, second], axis=1)
    whole = np.linalg.solve(basis, (points_mm - points_mm[0]).T)
    return bool(np.abs(whole - np.round(whole)).max() < 0.1)
