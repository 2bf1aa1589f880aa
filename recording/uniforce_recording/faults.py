"""Every fault of a recording by one name, the ``<cause>`` of ``aborted:<cause>``."""

from __future__ import annotations

from typing import Literal

from lerobot_camera_uniforce.faults import FrozenSensorError, LostSensorError, StaleSensorError
from uniforce_vtla.errors import (
    DatasetError,
    DiskFullError,
    DroppedFrameError,
    RobotError,
    SensorError,
    TeleoperatorError,
    UniForceError,
)
from uniforce_vtla.keys import ABORT_CAUSES

HOW = ((LostSensorError, "lost"), (StaleSensorError, "stale"), (FrozenSensorError, "frozen"))


class DeviceError(UniForceError):
    """A camera or finger can't be recorded from.

    Attributes:
        cause: one of ``keys.ABORT_CAUSES``.
        device: its name in the robot's config.
    """

    def __init__(self, cause: str, device: str, message: str) -> None:
        super().__init__(f"{device}: {message}")
        self.cause, self.device = cause, device


class StopRequestedError(UniForceError):
    """Somebody asked the program to end."""


def device_fault(kind: Literal["camera", "touch"], device: str, error: SensorError) -> DeviceError:
    """Return the fault that a sensor's error means."""
    how = next((name for error_type, name in HOW if isinstance(error, error_type)), "bad")
    return DeviceError(f"{how}_{kind}", device, str(error))


def cause_of(error: UniForceError) -> str:
    """Return the cause, one of ``keys.ABORT_CAUSES``."""
    match error:
        case DeviceError():
            return error.cause
        case RobotError():
            name = f"robot_{error.fault}"
            return name if name in ABORT_CAUSES else "robot_other"
        case TeleoperatorError():
            return "teleop"
        case DiskFullError():
            return "disk_full"
        case DroppedFrameError():
            return "dropped_frame"
        case DatasetError():
            return "storage"
        case StopRequestedError():
            return "interrupt"
        case _:
            return "other"
