"""Sensors outside the procedural family: proof that held-out sensors could not have been drawn in
pretraining."""

import numpy as np

from uniforce_vtla.tokenizer.family import FamilyBounds


def half_extent_px(sensor):
    """Return (2,) how far the layout reaches from the image's centre, in pixels."""
    return np.abs(sensor.spec.layout_mm).max(axis=0) * np.asarray(sensor.spec.px_per_mm)


def outside(sensor, bounds=None):
    """Return in which ways a camera sensor differs from everything the family can draw; empty if it
    could be one.

    ``visible: …`` entries show in a reference image, ``hidden: …`` do not.
    """
    spec, bounds = sensor.spec, bounds or FamilyBounds()
    is_flat = spec.dome_radius_mm is None
    found = []
    if spec.marker_shape not in (bounds.flat.shapes if is_flat else ("disc",)):
        found.append(f"visible: marker_shape {spec.marker_shape}")
    if not _is_lattice(spec.layout_mm):
        found.append("visible: layout is no lattice of the family")
    if np.any(half_extent_px(sensor) > (320, 240)):
        found.append("visible: layout reaches beyond the image")
    numbers = _of_gel(sensor, bounds.flat) if is_flat else _of_dome(sensor, bounds.dome)
    for name, value, (low, high) in numbers:
        if not low - 1e-9 <= value <= high + 1e-9:
            found.append(f"{name} {value:.3g} (family {low}–{high})")
    return found


def _of_gel(sensor, family):
    """Return name, the sensor's number and the family's range of each."""
    skin, material = sensor.material.layers[0], sensor.material
    return [
        ("visible: px_per_mm", sensor.spec.px_per_mm[0], family.px_per_mm),
        ("hidden: thickness", skin.thickness_mm, family.thickness_mm),
        ("hidden: Young's modulus", skin.young_MPa * material.stiffness, family.young_MPa),
        ("hidden: Poisson's ratio", skin.poisson, family.poisson),
        ("hidden: marker depth", material.readout_mm, family.readout_mm),
    ]


def _of_dome(sensor, family):
    (skin, filling), material = sensor.material.layers[:2], sensor.material
    return [
        ("visible: px_per_mm", sensor.spec.px_per_mm[0], family.px_per_mm),
        ("hidden: thickness", skin.thickness_mm, family.skin_mm),
        ("hidden: Young's modulus", skin.young_MPa * material.stiffness, family.skin_MPa),
        ("hidden: filling", filling.thickness_mm, family.filling_mm),
        ("hidden: pin", material.pin_mm, family.pin_mm),
    ]


def _is_lattice(points_mm):
    """Tell rectangular or hexagonal lattices: every marker's offset is a whole number of two basis
    steps."""
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
