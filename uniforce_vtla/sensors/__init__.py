"""Stage 1: what each sensor is, and how its raw signal looks."""

from uniforce_vtla.sensors.registry import get_sensor, list_sensors
from uniforce_vtla.sensors.spec import SensorSpec

__all__ = ["SensorSpec", "get_sensor", "list_sensors"]
