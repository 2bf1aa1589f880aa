"""A camera as a source of RGB frames: settings are made, read back, and sizes checked.

Exposure, white balance and gain are locked: a camera that brightens when pressed would look like
force. Order (V4L2 through OpenCV): pixel format first, since it decides which sizes exist; size,
rate, buffer; then the automatics off before the values they would overwrite. Control values were
never tried on hardware. A refused setting is an error that names the control; None leaves it alone.
"""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np

from uniforce_robots.sensors.config_uniforce import CapturedCameraConfig
from uniforce_robots.sensors.faults import LostSensorError, WrongSensorError
from uniforce_robots.sensors.reader import SampleSource, Stamped, now_ns
from uniforce_vtla.errors import expected, without_credentials

SYS_VIDEO = Path("/sys/class/video4linux")
FAILED_READS = 10  # in a row: the device is gone
MANUAL_EXPOSURE = 1.0  # V4L2: 1 manual, 3 aperture priority
TOLERANCE = 0.5  # drivers report whole units

CaptureFactory = Callable[[str], cv2.VideoCapture]


def open_capture(source: str) -> cv2.VideoCapture:
    """Return a capture of a device number or path, best ``/dev/v4l/by-path/…``.

    Raises LostSensorError: nothing there.
    """
    path = Path(f"/dev/video{source}" if source.isdigit() else source)
    if not path.exists():
        do = "List cameras with `ls /dev/v4l/by-path`."
        raise LostSensorError(expected("camera", f"a device {path}", "no such file", do))
    return cv2.VideoCapture(str(path), cv2.CAP_V4L2)


def first_node(source: str) -> str:
    """Return the /dev/videoN that has the pictures of ``source``'s camera, "" if ``source`` has.

    Many cameras have a second node that carries metadata alone.
    """
    name = f"video{source}" if source.isdigit() else Path(source).resolve().name
    node = SYS_VIDEO / name
    if not (node / "index").is_file() or int((node / "index").read_text()) == 0:
        return ""
    device = (node / "device").resolve()
    for index in SYS_VIDEO.glob("*/index"):
        first = index.parent
        if int(index.read_text()) == 0 and (first / "device").resolve() == device:
            return f"/dev/{first.name}"
    return "another one"


class FrameSource(SampleSource):
    """Base of a camera and a stream: (H, W, 3) uint8 RGB of the asked size, stamped on arrival."""

    def __init__(self, config: CapturedCameraConfig) -> None:
        super().__init__(without_credentials(f"{config.label} ({config.source})"))
        self._config = config

    def _stamped(self, bgr: np.ndarray) -> Stamped:
        """Return a frame that has just come; raises WrongSensorError for its size."""
        arrived_ns = now_ns()
        width, height = self._config.capture_size
        if bgr.shape[:2] != (height, width) and None not in (height, width):
            came = f"{bgr.shape[1]}×{bgr.shape[0]}"
            do = "Is this the right camera? Set its size in the config."
            raise WrongSensorError(expected(self.name, f"frames of {width}×{height}", came, do))
        self.counts.samples += 1
        return Stamped(arrived_ns, cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))


class CameraSource(FrameSource):
    """A camera behind V4L2; ``factory`` makes captures, tests script failures with it."""

    def __init__(
        self, config: CapturedCameraConfig, factory: CaptureFactory = open_capture
    ) -> None:
        super().__init__(config)
        self._factory = factory
        self._failed = 0

    def _connect(self, undo: ExitStack) -> None:
        """Open and set the camera; raises LostSensorError, or WrongSensorError for a setting."""
        self._capture = self._factory(self._config.source)
        self._failed = 0
        undo.callback(self._capture.release)
        if not self._capture.isOpened():
            do = self._advice("Is it plugged in, and used by no other program?")
            raise LostSensorError(expected(self.name, "a camera", "one that doesn't open", do))
        wanted = settings_in_order(self._config)
        for _, prop, value in wanted:
            self._capture.set(prop, value)
        is_now = {name: float(self._capture.get(prop)) for name, prop, _ in wanted}
        for name, _, value in wanted:
            if name != "buffer" and abs(is_now[name] - value) > TOLERANCE:  # few report the buffer
                offers = "`v4l2-ctl --list-formats-ext --list-ctrls`"
                do = f"Set one it offers ({offers}); exposure and gain may be null."
                raise WrongSensorError(
                    expected(f"{self.name}, {name}", f"{value:g}", f"{is_now[name]:g}", do)
                )
        self.settings_read_back = is_now

    def read(self) -> list[Stamped]:
        """Return the next frame, or nothing if none came."""
        ok, bgr = self._capture.read()
        if ok and bgr is not None:
            self._failed = 0
            return [self._stamped(bgr)]
        self._failed += 1
        self.counts.bad += 1
        if self._failed >= FAILED_READS:
            came = f"{self._failed} failed reads in a row"
            do = self._advice("Was it unplugged? Trying again.")
            raise LostSensorError(expected(self.name, "frames", came, do))
        return []

    def _advice(self, otherwise: str) -> str:
        first = first_node(self._config.source)
        if first:
            return f"It is a camera's metadata node, or another later one: give source={first}."
        return otherwise


def settings_in_order(config: CapturedCameraConfig) -> list[tuple[str, int, float]]:
    """Return (name, OpenCV property, value) in the order to set them."""
    width, height = config.capture_size
    manual = None if config.exposure_100us is None else MANUAL_EXPOSURE
    no_auto = None if config.white_balance_K is None else 0.0
    wanted = (
        ("fourcc", cv2.CAP_PROP_FOURCC, config.fourcc and cv2.VideoWriter.fourcc(*config.fourcc)),
        ("width", cv2.CAP_PROP_FRAME_WIDTH, width),
        ("height", cv2.CAP_PROP_FRAME_HEIGHT, height),
        ("fps", cv2.CAP_PROP_FPS, config.fps),
        ("buffer", cv2.CAP_PROP_BUFFERSIZE, 1.0),  # never a queue of old frames
        ("auto_exposure", cv2.CAP_PROP_AUTO_EXPOSURE, manual),
        ("exposure_100us", cv2.CAP_PROP_EXPOSURE, config.exposure_100us),
        ("auto_white_balance", cv2.CAP_PROP_AUTO_WB, no_auto),
        ("white_balance_K", cv2.CAP_PROP_WB_TEMPERATURE, config.white_balance_K),
        ("gain", cv2.CAP_PROP_GAIN, config.gain),
    )
    return [(name, prop, float(value)) for name, prop, value in wanted if value is not None]
