"""A camera as a source of frames: opened with its settings, every one read back, checked for size, in RGB.

A gel's picture must not change by itself: exposure, white balance and gain are locked, since a camera that brightens
when pressed would look like force.  Order (V4L2 through OpenCV): pixel format first, since it decides which sizes
exist; size, rate, buffer; then the automatics off before the values they would overwrite.  Control values were
never tried on hardware here: what a camera refuses is an error that names the control, and None leaves it alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from uniforce_robots.sensors.faults import LostSensorError, ProtocolError, WrongSensorError
from uniforce_robots.sensors.samples import NS_PER_MS, NS_PER_S, SourceCounts, Stamped, now_ns
from uniforce_vtla.errors import expected, without_credentials

FAILED_READS = 10  # in a row: the device is gone
OLDEST_S = 30.0  # a driver stamp older than this isn't on our clock
MANUAL_EXPOSURE = 1.0  # V4L2: 1 manual, 3 aperture priority
TOLERANCE = 0.5  # drivers report whole units


class Capture(Protocol):
    """The part of ``cv2.VideoCapture`` that is used here."""

    def isOpened(self) -> bool: ...  # noqa: D102, N802
    def set(self, prop: int, value: float) -> bool: ...  # noqa: D102
    def get(self, prop: int) -> float: ...  # noqa: D102
    def read(self) -> tuple[bool, np.ndarray | None]: ...  # noqa: D102
    def release(self) -> None: ...  # noqa: D102


CaptureFactory = Callable[[str], Capture]


@dataclass(frozen=True)
class CaptureSettings:
    """What is asked of a camera, in the config's units; None leaves a control as it is."""

    fourcc: str | None = "MJPG"
    width: int | None = None
    height: int | None = None
    fps: float | None = None
    exposure_100us: float | None = 100.0
    white_balance_K: float | None = 4600.0
    gain: float | None = 0.0

    def in_order(self) -> list[tuple[str, int, float]]:
        """Return (name, OpenCV property, value) in the order to set them."""
        code = None if self.fourcc is None else float(cv2.VideoWriter.fourcc(*self.fourcc))
        manual = None if self.exposure_100us is None else MANUAL_EXPOSURE
        no_auto = None if self.white_balance_K is None else 0.0
        wanted = (
            ("fourcc", cv2.CAP_PROP_FOURCC, code),
            ("width", cv2.CAP_PROP_FRAME_WIDTH, self.width),
            ("height", cv2.CAP_PROP_FRAME_HEIGHT, self.height),
            ("fps", cv2.CAP_PROP_FPS, self.fps),
            ("buffer", cv2.CAP_PROP_BUFFERSIZE, 1.0),  # never a queue of old frames
            ("auto_exposure", cv2.CAP_PROP_AUTO_EXPOSURE, manual),
            ("exposure_100us", cv2.CAP_PROP_EXPOSURE, self.exposure_100us),
            ("auto_white_balance", cv2.CAP_PROP_AUTO_WB, no_auto),
            ("white_balance_K", cv2.CAP_PROP_WB_TEMPERATURE, self.white_balance_K),
            ("gain", cv2.CAP_PROP_GAIN, self.gain),
        )
        return [(name, prop, float(value)) for name, prop, value in wanted if value is not None]


def open_capture(source: str) -> Capture:
    """Return a capture of a device number or a device path (best ``/dev/v4l/by-path/…``).

    Raises:
        LostSensorError: nothing there.
    """
    if source.isdigit():
        source = f"/dev/video{source}"
    if not Path(source).exists():
        do = "List cameras with `ls /dev/v4l/by-path`."
        raise LostSensorError(expected("camera", f"a device {source}", "no such file", do))
    return cv2.VideoCapture(source, cv2.CAP_V4L2)


class FrameSource:
    """What a camera and a stream share: frames (H, W, 3) uint8 RGB of the size asked for, stamped.

    Args:
        source: device number, device path or http address.
        settings: what to ask of the camera; a stream's server sets its own.
        name: how errors call the sensor.
        clock: what stamps a frame: "host", when it arrived, or "driver", when the camera took it
            (V4L2 stamps on the host's monotonic clock; never tried on hardware).

    Attributes:
        settings_read_back: what the driver said each setting was, kept for the dataset; empty for a stream.
    """

    def __init__(self, source: str, settings: CaptureSettings, name: str, clock: str = "host") -> None:
        self.name = without_credentials(f"{name} ({source})")
        self.settings_read_back: dict[str, float] = {}
        self._source, self._settings, self._clock = source, settings, clock
        self._frames = self._skipped = self._bad = 0

    @property
    def counts(self) -> SourceCounts:
        """Frames delivered, images left out for a newer one, and reads or images that failed."""
        return SourceCounts(self._frames, self._skipped, self._bad)

    def _stamped(self, bgr: np.ndarray, taken_ms: float) -> Stamped:
        """Return a frame that has just come; raises WrongSensorError for its size, ProtocolError for its time."""
        arrived_ns = now_ns()
        wanted = self._settings.height, self._settings.width
        if bgr.shape[:2] != wanted and None not in wanted:
            came = f"{bgr.shape[1]}×{bgr.shape[0]}"
            do = "Is this the right camera? Set its size in the config."
            raise WrongSensorError(expected(self.name, f"frames of {wanted[1]}×{wanted[0]}", came, do))
        stamp_ns = arrived_ns if self._clock == "host" else round(taken_ms * NS_PER_MS)
        if not arrived_ns - OLDEST_S * NS_PER_S < stamp_ns <= arrived_ns:
            came = f"{(arrived_ns - stamp_ns) / NS_PER_S:.3f} s ago"
            do = "This driver's clock isn't the host's: use clock=host."
            raise ProtocolError(expected(self.name, "a time stamp on the host's clock", came, do))
        self._frames += 1
        return Stamped(stamp_ns, cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))


class CameraSource(FrameSource):
    """A camera behind V4L2; ``factory`` makes captures, tests script failures with it."""

    def __init__(
        self,
        source: str,
        settings: CaptureSettings,
        name: str,
        clock: str = "host",
        factory: CaptureFactory = open_capture,
    ) -> None:
        super().__init__(source, settings, name, clock)
        self._factory = factory
        self._capture: Capture | None = None
        self._failed = 0

    def open(self) -> None:
        """Open and set the camera.

        Raises:
            LostSensorError: nothing there.
            WrongSensorError: it refuses a setting.
        """
        self.close()
        self._capture, self._failed = self._factory(self._source), 0
        try:
            if not self._capture.isOpened():
                do = "Is it plugged in, and used by no other program?"
                raise LostSensorError(expected(self.name, "a camera", "one that doesn't open", do))
            self.settings_read_back = self._apply_settings(self._capture)
        except (LostSensorError, WrongSensorError):
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
        if ok and bgr is not None:
            self._failed = 0
            return [self._stamped(bgr, self._capture.get(cv2.CAP_PROP_POS_MSEC))]
        self._failed, self._bad = self._failed + 1, self._bad + 1
        if self._failed >= FAILED_READS:
            came = f"{self._failed} failed reads in a row"
            raise LostSensorError(expected(self.name, "frames", came, "Was it unplugged? Trying again."))
        return []

    def close(self) -> None:
        """Let go of the camera."""
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.release()

    def _apply_settings(self, capture: Capture) -> dict[str, float]:
        """Set everything in order; return what the driver says it is now, by name."""
        wanted = self._settings.in_order()
        for _, prop, value in wanted:
            capture.set(prop, value)
        is_now = {setting: float(capture.get(prop)) for setting, prop, _ in wanted}
        for setting, _, value in wanted:
            if setting != "buffer" and abs(is_now[setting] - value) > TOLERANCE:  # few report the buffer
                what = f"{self.name}, {setting}"
                do = f"Choose a value it offers (`v4l2-ctl --list-ctrls`), or {setting}=null to leave it."
                raise WrongSensorError(expected(what, f"{value:g}", f"{is_now[setting]:g}", do))
        return is_now
