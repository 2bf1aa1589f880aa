"""What a finger wears in the scene: a sensor of the registry as drawn, or any sensor as the unit it is."""

from __future__ import annotations

from dataclasses import dataclass, field

from uniforce_vtla.contact.units import UnitVariation
from uniforce_vtla.contact.virtual import VirtualSensor, as_virtual


@dataclass(frozen=True)
class WornSensor:
    """One unit of a sensor on a finger."""

    sensor: VirtualSensor  # its drawing and material
    unit: UnitVariation = field(default_factory=UnitVariation)  # how this one differs from the drawing

    @property
    def kind(self) -> str:
        """Registry name of the sensor whose body it has: decides the pad in the simulator and what a policy knows."""
        return self.sensor.like


def worn(sensor: str | WornSensor) -> WornSensor:
    """Return the sensor to wear; a name gives the drawing itself.

    Raises:
        SensorError: an unknown name.
    """
    return sensor if isinstance(sensor, WornSensor) else WornSensor(as_virtual(sensor))
