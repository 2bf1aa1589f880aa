"""The sensors this project knows. Adding one: a file beside this one and a line below."""

from uniforce_vtla.errors import SensorError, expected, nearest
from uniforce_vtla.sensors.gelsight import GELSIGHT
from uniforce_vtla.sensors.paxini import PAXINI
from uniforce_vtla.sensors.spec import SensorSpec
from uniforce_vtla.sensors.tac3d import TAC3D
from uniforce_vtla.sensors.tactip import TACTIP
from uniforce_vtla.sensors.uskin import USKIN

_SENSORS = {spec.name: spec for spec in (GELSIGHT, TACTIP, USKIN, PAXINI, TAC3D)}


def list_sensors() -> tuple[str, ...]:
    """Return the names of all known sensors; a name's place is its index in datasets."""
    return tuple(_SENSORS)


def get_sensor(name: str) -> SensorSpec:
    """Return the facts of the sensor called ``name``; raise SensorError listing the known ones."""
    if not isinstance(name, str) or name not in _SENSORS:
        do = nearest(str(name), _SENSORS, "Check the spelling or register it.")
        raise SensorError(expected("sensor", " | ".join(_SENSORS), repr(name), do))
    return _SENSORS[name]
