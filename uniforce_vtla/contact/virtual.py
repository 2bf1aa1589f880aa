"""Sensors that exist only here: any layout, marker and view with any material.

The three real sensors are the registry's; a *virtual* one shows what the tokenizer does on a sensor nobody has
pretrained on.  GelSight-D (diamonds on a staggered lattice) is the one the paper tests with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.contact.materials import MATERIALS, PadMaterial, TaxelMaterial, get_material
from uniforce_vtla.sensors import SensorSpec, get_sensor
from uniforce_vtla.sensors.layouts import staggered


@dataclass(frozen=True)
class VirtualSensor:
    """A sensor's drawing and how it answers to load.

    Attributes:
        spec: layout, marker, view, pad.
        material: stiffness, gains, lens.
        like: registry name of the real sensor whose canonicaliser and raw look it shares.
    """

    spec: SensorSpec
    material: PadMaterial | TaxelMaterial
    like: str

    @property
    def name(self) -> str:
        """The drawing's name."""
        return self.spec.name


GELSIGHT_D = VirtualSensor(
    SensorSpec(
        name="gelsight_d",
        signal="camera",
        raw_shape=(480, 640, 3),
        layout_mm=staggered(rows=9, columns=9, pitch_mm=(2.7, 2.2)),  # 77 diamonds on a 25 mm pad
        px_per_mm=(24.0, 24.0),
        marker_shape="diamond",
        marker_size_mm=0.95,
        pad_size_mm=(25.0, 25.0),
        dome_radius_mm=None,
        rated_depth_mm=1.5,
        rate_hz=30.0,
        source="GenForce's diamond pattern as the UniForce paper names it; only the name is documented",
    ),
    MATERIALS["gelsight"],
    like="gelsight",
)


def as_virtual(sensor: str | VirtualSensor) -> VirtualSensor:
    """Return a registry sensor with its material, or the virtual sensor itself.

    Raises:
        SensorError: an unknown name.
    """
    if isinstance(sensor, VirtualSensor):
        return sensor
    if sensor == GELSIGHT_D.name:
        return GELSIGHT_D
    return VirtualSensor(get_sensor(sensor), get_material(sensor), like=sensor)


def half_extent_px(sensor: VirtualSensor) -> np.ndarray:
    """Return (2,) how far the layout reaches from the image's centre, in pixels."""
    return np.abs(sensor.spec.layout_mm).max(axis=0) * np.asarray(sensor.spec.px_per_mm)
