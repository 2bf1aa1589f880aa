"""A tactile camera's connection: settings in the one order drivers accept, every one of them read back.

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

from uniforce_robots.sensors.faults import LostSensorError, WrongSensorError
from uniforce_robots.sensors.http_capture import HttpCapture
from uniforce_vtla.errors import expected

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
    """What is asked of a camera; None leaves a control as it is.

    Attributes:
        fourcc: pixel format; MJPG, or several cameras don't fit on one USB 2 bus.
        width: px.
        height: px.
        fps: frames per second.
        exposure_100us: exposure time in V4L2's unit of 100 µs.
        white_balance_K: colour temperature.
        gain: driver's own unit.
    """

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


def is_url(source: str) -> bool:
    """Return whether ``source`` is an address rather than a device."""
    return source.startswith(("http://", "https://"))


def open_capture(source: str) -> Capture:
    """Return a capture of a device number, a device path (best ``/dev/v4l/by-path/…``) or an http address.

    Raises:
        LostSensorError: nothing there.
    """
    if is_url(source):
        return HttpCapture(source)
    if source.isdigit():
        source = f"/dev/video{source}"
    if not Path(source).exists():
        do = "List cameras with `ls /dev/v4l/by-path`."
        raise LostSensorError(expected("camera", f"a device {source}", "no such file", do))
    return cv2.VideoCapture(source, cv2.CAP_V4L2)


def apply_settings(capture: Capture, settings: CaptureSettings, name: str) -> dict[str, float]:
    """Set everything in order; return what the driver says it is now, by name.

    Raises:
        WrongSensorError: the driver kept another value than was asked for.
    """
    wanted = settings.in_order()
    for _, prop, value in wanted:
        capture.set(prop, value)
    is_now = {setting: float(capture.get(prop)) for setting, prop, _ in wanted}
    for setting, _, value in wanted:
        if setting != "buffer" and abs(is_now[setting] - value) > TOLERANCE:  # few drivers report the buffer
            do = f"Choose a value the camera offers (`v4l2-ctl --list-ctrls`), or {setting}=null to leave it."
            raise WrongSensorError(expected(f"{name}, {setting}", f"{value:g}", f"{is_now[setting]:g}", do))
    return is_now
