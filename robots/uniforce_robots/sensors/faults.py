"""Faults of a tactile device, one class each, also as LeRobot's camera contract names them."""

from uniforce_vtla.errors import SensorError


class StaleSensorError(SensorError, TimeoutError):
    """The newest sample is older than allowed, or none came in time."""


class LostSensorError(SensorError, ConnectionError):
    """The device can't be opened, or went away; the reader keeps trying to get it back."""


class FrozenSensorError(SensorError):
    """Samples keep coming, but all with the same content: the sensor itself has stopped."""


class WrongSensorError(SensorError):
    """The device isn't the one of the config: size, rate, setting, number of taxels."""


class SimulatedSensorError(SensorError):
    """The server invents its data (bus type "sim"): it looks alive and measures nothing."""


class ProtocolError(SensorError):
    """Bytes that break the device's protocol beyond repair; the connection has to be made anew."""
