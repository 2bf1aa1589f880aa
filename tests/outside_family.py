"""Sensors outside the procedural family: proof that held-out sensors could not have been drawn in pretraining."""

import numpy as np

from uniforce_vtla.sensors.material import PadMaterial
from uniforce_vtla.tokenizer.family import FamilyBounds


def half_extent_px(sensor):
    """Return (2,) how far the layout reaches from the image's centre, in pixels."""
    return np.abs(sensor.spec.layout_mm).max(axis=0) * np.asarray(sensor.spec.px_per_mm)


def outside(sensor, bounds=None):
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
    return found + [
        f"hidden: {name} {value:.3g} (family {span[0]}–{span[1]})"
        for name, (value, span) in _hidden_numbers(
            material, b, flat=spec.dome_radius_mm is None
        ).items()
        if not span[0] - 1e-9 <= value <= span[1] + 1e-9
    ]


def _hidden_numbers(material, b, flat):
    """Return name → (the material's number, the family's range) of what no reference image shows."""
    skin = material.layers[0]
    young = skin.young_MPa * material.stiffness
    if flat:
        return {
            "thickness": (skin.thickness_mm, b.flat.thickness_mm),
            "Young's modulus": (young, b.flat.young_MPa),
            "Poisson's ratio": (skin.poisson, b.flat.poisson),
            "marker depth": (material.readout_mm, b.flat.readout_mm),
        }
    return {
        "thickness": (skin.thickness_mm, b.dome.skin_mm),
        "Young's modulus": (young, b.dome.skin_MPa),
        "filling": (material.layers[1].thickness_mm, b.dome.filling_mm),
        "pin": (material.pin_mm, b.dome.pin_mm),
    }


def _is_lattice(points_mm):
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
