"""How a tactile device fails, one class per way.  Each is also the exception LeRobot's camera contract names."""

from uniforce_vtla.errors import SensorError


class StaleSensorError(SensorError, TimeoutError):
    """The newest sample is older than allowed, or none came in time."""


class LostSensorError(SensorError, ConnectionError):
    """The device can't be opened, or went away; the reader keeps trying to get it back."""


class FrozenSensorError(SensorError):
    """Samples keep coming, but all with the same content: the sensor itself has stopped."""


class WrongSensorError(SensorError):
    """The device answers, but it isn't what the config says: size, rate, setting, number of taxels."""


class SimulatedSensorError(SensorError):
    """The server invents its data (bus type "sim"): it looks alive and measures nothing."""


class ProtocolError(SensorError):
    """Bytes that break the device's protocol beyond repair; the connection has to be made anew."""
