"""A camera as a source of frames: opened with its settings, checked for size, in RGB."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np

from uniforce_robots.sensors.capture import (
    Capture,
    CaptureFactory,
    CaptureSettings,
    apply_settings,
    is_url,
    open_capture,
)
from uniforce_robots.sensors.faults import LostSensorError, ProtocolError, WrongSensorError
from uniforce_robots.sensors.http_capture import HttpCapture
from uniforce_robots.sensors.samples import NS_PER_MS, NS_PER_S, now_ns
from uniforce_robots.sensors.sources import SourceCounts, Stamped
from uniforce_vtla.errors import expected, without_credentials

Clock = Literal["host", "driver"]
FAILED_READS = 10  # in a row: the device is gone; an http source waits 0.1 s in each
OLDEST_S = 30.0  # a driver stamp older than this isn't on our clock


class CameraSource:
    """Frames (H, W, 3) uint8 RGB of one camera.

    Args:
        source: device number, device path or http address.
        settings: what to ask of the camera; a stream's server sets its own.
        name: how errors call the sensor.
        clock: what stamps a frame: "host", when it arrived, or "driver", when the camera took it
            (``CAP_PROP_POS_MSEC``; V4L2 stamps on the host's monotonic clock; never tried on hardware).
        factory: makes captures; tests script failures with it.

    Attributes:
        settings_read_back: what the driver said each setting was, kept for the dataset.
    """

    def __init__(
        self,
        source: str,
        settings: CaptureSettings,
        name: str,
        clock: Clock = "host",
        factory: CaptureFactory = open_capture,
    ) -> None:
        self.name = without_credentials(f"{name} ({source})")
        self.settings_read_back: dict[str, float] = {}
        self._source, self._settings, self._clock, self._factory = source, settings, clock, factory
        self._capture: Capture | None = None
        self._failed = self._frames = self._bad = self._skipped = 0

    @property
    def counts(self) -> SourceCounts:
        """Frames delivered, images left out for a newer one, and reads or images that failed."""
        skipped, bad = _of_stream(self._capture)
        return SourceCounts(self._frames, self._skipped + skipped, self._bad + bad)

    def open(self) -> None:
        """Open and set the camera.

        Raises:
            LostSensorError: nothing there.
            WrongSensorError: it refuses a setting.
        """
        self.close()
        capture = self._factory(self._source)
        self._capture, self._failed = capture, 0
        if not capture.isOpened():
            self.close()
            do = "Is it plugged in, and used by no other program?"
            raise LostSensorError(expected(self.name, "a camera", "one that doesn't open", do))
        if is_url(self._source):
            return
        try:
            self.settings_read_back = apply_settings(capture, self._settings, self.name)
        except WrongSensorError:
            self.close()
            raise

    def read(self) -> list[Stamped]:
        """Return the next frame, or nothing if none came.

        Raises:
            LostSensorError: the camera went away.
            WrongSensorError: a frame of another size than asked for.
            ProtocolError: no usable time stamp although ``clock`` is "driver".
        """
        if self._capture is None:
            raise LostSensorError(expected(self.name, "an open camera", "closed", "Call open()."))
        ok, bgr = self._capture.read()
        arrived_ns = now_ns()
        if not ok or bgr is None:
            return self._failed_read()
        self._failed = 0
        self._check_size(bgr)
        stamp_ns = arrived_ns if self._clock == "host" else self._driver_stamp_ns(self._capture, arrived_ns)
        self._frames += 1
        return [Stamped(stamp_ns, cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))]

    def close(self) -> None:
        """Let go of the camera."""
        capture, self._capture = self._capture, None
        if capture is None:
            return
        skipped, bad = _of_stream(capture)
        self._skipped, self._bad = self._skipped + skipped, self._bad + bad
        capture.release()

    def _failed_read(self) -> list[Stamped]:
        self._failed += 1
        self._bad += not is_url(self._source)  # a stream's silence isn't a bad image
        if self._failed >= FAILED_READS:
            came = f"{self._failed} failed reads in a row"
            raise LostSensorError(expected(self.name, "frames", came, "Was it unplugged? Trying again."))
        return []

    def _check_size(self, frame: np.ndarray) -> None:
        wanted = self._settings.height, self._settings.width
        if frame.shape[:2] != wanted and None not in wanted:
            came = f"{frame.shape[1]}×{frame.shape[0]}"
            do = "Is this the right camera? Set its size in the config."
            raise WrongSensorError(expected(self.name, f"frames of {wanted[1]}×{wanted[0]}", came, do))

    def _driver_stamp_ns(self, capture: Capture, arrived_ns: int) -> int:
        stamp_ns = round(capture.get(cv2.CAP_PROP_POS_MSEC) * NS_PER_MS)
        if not arrived_ns - OLDEST_S * NS_PER_S < stamp_ns <= arrived_ns:
            came = f"{(arrived_ns - stamp_ns) / NS_PER_S:.3f} s ago"
            do = "This driver's clock isn't the host's: use clock=host."
            raise ProtocolError(expected(self.name, "a time stamp on the host's clock", came, do))
        return stamp_ns


def _of_stream(capture: Capture | None) -> tuple[int, int]:
    """Return images skipped and images that couldn't be decoded; a device hides both."""
    return (capture.skipped, capture.bad) if isinstance(capture, HttpCapture) else (0, 0)
