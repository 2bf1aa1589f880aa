"""Procedural sensors for pretraining: random layouts, markers, views and pad materials.

The encoder reads layout and view off the reference image. The material leaves no trace in free
air. An unseen sensor's force scale must be calibrated.
"""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from uniforce_vtla.contact.virtual import VirtualSensor, get_material
from uniforce_vtla.sensors import SensorSpec
from uniforce_vtla.sensors.layouts import hexagonal, rectangular, turned
from uniforce_vtla.sensors.material import Layer, PadMaterial

Span = tuple[float, float]
_SEED = 20_261  # draws the bodies
WIDEST_PX = (310.0, 232.0)  # a layout's reach from the centre that still fits 640×480


@dataclass(frozen=True)
class FlatFamily:
    """Flat gels with printed markers, around the GelSight."""

    pitch_mm: Span = (1.7, 3.4)  # FOTS' gels 1.3–1.5, ours 2.5
    stretch: Span = (0.8, 1.25)  # pitch in y over pitch in x
    size_of_pitch: Span = (0.26, 0.50)  # marker over pitch: dots and squares of real gels
    px_per_mm: Span = (17.0, 30.0)  # lens
    shapes: tuple[str, ...] = ("square", "disc")
    layouts: tuple[str, ...] = ("rectangular", "hexagonal")
    pad_mm: Span = (21.0, 29.0)  # side of the gel
    thickness_mm: Span = (3.0, 5.0)
    poisson: Span = (0.46, 0.49)
    readout_mm: Span = (0.3, 1.0)  # depth of the markers
    young_MPa: Span = (0.4, 0.62)


@dataclass(frozen=True)
class DomeFamily:
    """Domes with pins, around the TacTip."""

    rings: tuple[int, int] = (4, 10)  # 61 to 331 pins; TacTips in use have 127 and 331
    reach_mm: Span = (15.5, 19.0)  # outermost pin from the centre
    size_mm: Span = (0.8, 1.7)  # pin head
    px_per_mm: Span = (9.5, 12.5)  # lens
    fisheye: Span = (0.03, 0.11)  # shows in the spacing of the outer pins
    skin_mm: Span = (0.8, 1.2)
    skin_MPa: Span = (0.32, 0.5)
    filling_mm: Span = (11.0, 17.0)  # gel at the rim
    pin_mm: Span = (1.5, 2.5)


@dataclass(frozen=True)
class FamilyBounds:
    """Everything a procedural sensor is drawn from."""

    flat: FlatFamily = field(default_factory=FlatFamily)
    dome: DomeFamily = field(default_factory=DomeFamily)
    bodies: int = 12  # gels, and as many domes: each is one solution of finite elements


def draw_flat(rng: np.random.Generator, bounds: FamilyBounds | None = None) -> VirtualSensor:
    """Return a random flat gel."""
    b = bounds or FamilyBounds()
    flat = b.flat
    pitch = rng.uniform(*flat.pitch_mm)
    stretch = rng.uniform(*flat.stretch)
    pad, material = flat_bodies(b)[rng.integers(b.bodies)]
    scale = rng.uniform(*flat.px_per_mm)
    layout = str(rng.choice(flat.layouts))
    points = _flat_layout(layout, pitch, stretch, rng.uniform(-np.pi, np.pi), pad, scale)
    spec = SensorSpec(
        name=f"flat_{layout}",
        layout_mm=points,
        px_per_mm=(scale, scale),
        marker_shape=str(rng.choice(flat.shapes)),  # type: ignore[arg-type]
        marker_size_mm=rng.uniform(*flat.size_of_pitch) * pitch * min(1.0, stretch),
        pad_size_mm=(pad, pad),
        rated_depth_mm=1.5,
        source="procedural",
    )
    stiffness = rng.uniform(*flat.young_MPa)  # of bodies solved for 1 MPa
    return VirtualSensor(spec, replace(material, stiffness=stiffness), like="gelsight")


def draw_dome(rng: np.random.Generator, bounds: FamilyBounds | None = None) -> VirtualSensor:
    """Return a random dome."""
    b = bounds or FamilyBounds()
    dome = b.dome
    count = int(rng.integers(dome.rings[0], dome.rings[1] + 1))
    pitch = rng.uniform(*dome.reach_mm) / count
    material = replace(
        dome_bodies(b)[rng.integers(b.bodies)], stiffness=rng.uniform(*dome.skin_MPa)
    )
    fisheye = rng.uniform(*dome.fisheye)
    scale = rng.uniform(*dome.px_per_mm)
    spec = SensorSpec(
        name="dome_hexagonal",
        layout_mm=turned(hexagonal(count, pitch), rng.uniform(-np.pi, np.pi)).astype(np.float32),
        px_per_mm=(scale, scale),
        marker_shape="disc",
        marker_size_mm=min(rng.uniform(*dome.size_mm), 0.6 * pitch),  # pins never touch at rest
        pad_size_mm=(40.0, 40.0),
        fisheye=fisheye,
        dome_radius_mm=41.5,
        rated_depth_mm=5.0,
        source="procedural",
    )
    return VirtualSensor(spec, material, like="tactip")


def _flat_layout(
    layout: str, pitch: float, stretch: float, angle_rad: float, pad: float, px_per_mm: float
) -> np.ndarray:
    """Return the markers of a turned lattice that lie on the gel and in the image."""
    if layout == "hexagonal":
        points = hexagonal(14, pitch) * np.array([1.0, stretch], np.float32)
    else:
        points = rectangular(31, 31, (pitch, pitch * stretch))
    points = turned(points, angle_rad).astype(np.float32)
    reach = np.minimum(pad / 2 - 0.3 * pitch, np.array(WIDEST_PX) / px_per_mm - 0.5 * pitch)
    return points[np.all(np.abs(points) <= reach, axis=1)]


@cache
def flat_bodies(bounds: FamilyBounds) -> tuple[tuple[float, PadMaterial], ...]:
    """Return sides in mm and materials of gels of 1 MPa, the same ones in every run."""
    rng = np.random.default_rng(_SEED)
    flat = bounds.flat
    found = []
    for _ in range(bounds.bodies):
        side = round(rng.uniform(*flat.pad_mm))  # whole cells
        layer = Layer(
            round(rng.uniform(*flat.thickness_mm), 2), 1.0, round(rng.uniform(*flat.poisson), 3)
        )
        found.append((float(side), PadMaterial((layer,), round(rng.uniform(*flat.readout_mm), 2))))
    return tuple(found)


@cache
def dome_bodies(bounds: FamilyBounds) -> tuple[PadMaterial, ...]:
    """Return materials of ``bounds.bodies`` domes whose skin has 1 MPa."""
    rng = np.random.default_rng(_SEED)
    dome = bounds.dome
    usual = get_material("tactip")
    assert isinstance(usual, PadMaterial)
    skin, filling = usual.layers
    soft = filling.young_MPa / skin.young_MPa
    found = []
    for _ in range(bounds.bodies):
        thickness = round(rng.uniform(*dome.skin_mm), 2)
        layers = (
            Layer(thickness, 1.0, skin.poisson),
            Layer(round(rng.uniform(*dome.filling_mm), 1), soft, filling.poisson),
        )
        pin_mm = round(rng.uniform(*dome.pin_mm), 2)
        found.append(replace(usual, layers=layers, readout_mm=thickness, pin_mm=pin_mm))
    return tuple(found)
