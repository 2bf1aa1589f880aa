"""Sensors that exist only in simulation: any layout, marker and view with any material.

They show how the tokenizer does on a sensor it was never pretrained on. The paper tests with
GelSight-D (diamonds on a staggered lattice).
"""

from dataclasses import dataclass, replace

from uniforce_vtla.contact.elastic import Gel
from uniforce_vtla.errors import SensorError, expected
from uniforce_vtla.sensors import SensorSpec, get_sensor
from uniforce_vtla.sensors.layouts import staggered
from uniforce_vtla.sensors.material import Material, TaxelMaterial


def gel_of(spec: SensorSpec, material: Material) -> Gel:
    """Return the body that finite elements are solved for."""
    return Gel(
        spec.pad_size_mm,
        material.layers,
        material.readout_mm,
        spec.dome_radius_mm,
        material.cell_mm,
    )


def get_material(sensor: str) -> Material:
    """Return the material of ``sensor``; raise SensorError where its file says none."""
    material = get_sensor(sensor).material
    if material is None:
        do = "Say `material` in the sensor's file."
        raise SensorError(expected(f"{sensor}, simulated", "a material", "none", do))
    return material


@dataclass(frozen=True)
class VirtualSensor:
    """A sensor's drawing and how it answers to load."""

    spec: SensorSpec  # layout, marker, view, pad
    material: Material  # stiffness, gains, lens
    like: str  # registry name of the real sensor whose canonicalizer and raw look it shares

    @property
    def name(self) -> str:
        """The drawing's name."""
        return self.spec.name


GELSIGHT_D = VirtualSensor(
    SensorSpec(
        name="gelsight_d",
        layout_mm=staggered(rows=9, columns=9, pitch_mm=(2.7, 2.2)),  # 77 diamonds on a 25 mm pad
        px_per_mm=(24.0, 24.0),
        marker_shape="diamond",
        marker_size_mm=0.95,
        pad_size_mm=(25.0, 25.0),
        rated_depth_mm=1.5,
        source="GenForce's diamond pattern as the UniForce paper names it; "
        "only the name is documented",
    ),
    get_material("gelsight"),
    like="gelsight",
)


def as_virtual(sensor: str | VirtualSensor) -> VirtualSensor:
    """Return a registry sensor with its material, or the virtual sensor; SensorError: unknown."""
    if isinstance(sensor, VirtualSensor):
        return sensor
    if sensor == GELSIGHT_D.name:
        return GELSIGHT_D
    return VirtualSensor(get_sensor(sensor), get_material(sensor), like=sensor)


def hidden_sensors() -> dict[str, VirtualSensor]:
    """Return usual-looking sensors that respond × .6 to × 1.5, for calibration."""
    gel = get_material("gelsight")
    taxels = get_material("uskin")
    assert isinstance(taxels, TaxelMaterial)
    materials: dict[str, Material] = {
        "gelsight_stiff": replace(gel, stiffness=1.6),
        "gelsight_soft": replace(gel, stiffness=0.7),
        "tactip_soft": replace(get_material("tactip"), stiffness=0.65),
        "uskin_keen": replace(taxels, rest_counts=1.5 * taxels.rest_counts),
        "uskin_dull": replace(taxels, rest_counts=0.6 * taxels.rest_counts),
    }
    found = {}
    for name, material in materials.items():
        like = name.partition("_")[0]
        found[name] = VirtualSensor(replace(get_sensor(like), name=name), material, like)
    return found


def any_virtual(name: str) -> VirtualSensor:
    """Return a sensor by name, one of ``hidden_sensors`` too; SensorError: unknown."""
    return hidden_sensors().get(name) or as_virtual(name)
