"""Name every fault of a recording, the ``<cause>`` of ``aborted:<cause>``; Ctrl-C is one too."""

import logging
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Literal

from uniforce_robots.sensors.faults import FrozenSensorError, LostSensorError, StaleSensorError
from uniforce_vtla import errors
from uniforce_vtla.keys import ABORT_CAUSES
from uniforce_vtla.terminal import STOPS

log = logging.getLogger(__name__)


class DeviceError(errors.UniForceError):
    """A camera or finger can't be recorded from; ``cause`` is one of ``keys.ABORT_CAUSES``."""

    def __init__(self, cause: str, message: str) -> None:
        super().__init__(message)
        self.cause = cause


class StopRequestedError(errors.UniForceError):
    """Ctrl-C, SIGTERM or a closed terminal: the program is to end."""


HOW = {LostSensorError: "lost", StaleSensorError: "stale", FrozenSensorError: "frozen"}
CAUSES: dict[type[errors.UniForceError], str] = {  # the first that fits
    errors.TeleoperatorError: "teleop",
    errors.DiskFullError: "disk_full",
    errors.DroppedFrameError: "dropped_frame",
    errors.DatasetError: "storage",
    StopRequestedError: "interrupt",
    errors.UniForceError: "other",
}


@contextmanager
def handled(handler: Callable[..., None] | signal.Handlers) -> Iterator[dict[signal.Signals, Any]]:
    """Handle stop signals so while the block lasts; yield how each was handled before."""
    before = {number: signal.signal(number, handler) for number in STOPS}
    try:
        yield before
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


@contextmanager
def named(kind: Literal["camera", "touch"], device: str) -> Iterator[None]:
    """Turn a sensor's error into the fault of the device with this name in the robot's config."""
    try:
        yield
    except errors.SensorError as error:
        how = next(
            (name for error_type, name in HOW.items() if isinstance(error, error_type)), "bad"
        )
        raise DeviceError(f"{how}_{kind}", f"{device}: {error}") from error


def cause_of(error: errors.UniForceError) -> str:
    """Return the cause, one of ``keys.ABORT_CAUSES``."""
    if isinstance(error, DeviceError):
        return error.cause
    if isinstance(error, errors.RobotError):
        name = f"robot_{error.fault}"
        return name if name in ABORT_CAUSES else "robot_other"
    return next(cause for error_type, cause in CAUSES.items() if isinstance(error, error_type))


class Interrupts:
    """Ctrl-C, SIGTERM, SIGHUP: the first one ends the session in order.

    Each further Ctrl-C or SIGTERM raises KeyboardInterrupt where it stands. SIGHUP comes from
    kernel, shell and login manager alike, and nobody insists by it.
    """

    def __init__(self) -> None:
        self.count = self._asked = 0

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Count while the block lasts; in the main thread only, as signals are."""
        with handled(self._take) as before:
            # nohup: it is to go on without its terminal
            if before[signal.SIGHUP] is signal.SIG_IGN:
                signal.signal(signal.SIGHUP, signal.SIG_IGN)
            yield

    def _take(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
        self._asked += number != signal.SIGHUP
        log.warning("interrupted (%s), %d time(s)", signal.Signals(number).name, self.count)
        if self._asked > 1:
            raise KeyboardInterrupt
