"""A sensor's material as the contact model takes it."""

from uniforce_vtla.contact.elastic import Gel
from uniforce_vtla.errors import SensorError, expected
from uniforce_vtla.sensors import SensorSpec, get_sensor
from uniforce_vtla.sensors.material import Material


def gel_of(spec: SensorSpec, material: Material) -> Gel:
    """Return the body that finite elements are solved for."""
    return Gel(spec.pad_size_mm, material.layers, material.readout_mm, spec.dome_radius_mm, material.cell_mm)


def get_material(sensor: str) -> Material:
    """Return the material of ``sensor``; raise SensorError where its file says none."""
    material = get_sensor(sensor).material
    if material is None:
        do = "Say `material` in the sensor's file."
        raise SensorError(expected(f"{sensor}, simulated", "a material", "none", do))
    return material
