"""Settings of the tactile fingers, as LeRobot camera configs.

A patch or camera may be mounted turned; its samples are brought upright. Which way a uSkin's rows
run on a finger wasn't seen on hardware: ``uniforce touch check=orientation`` finds it. A camera may
sit at any angle: ``check=angle`` finds that.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from lerobot.cameras.configs import CameraConfig

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE, TAXEL_SHAPE, check_finger
from uniforce_vtla.errors import ContractError, expected, require_one_of
from uniforce_vtla.options import Range
from uniforce_vtla.sensors import get_sensor

TURNS = (0, 90, 180, 270)
SIDE = 4  # taxels per side
FULL_SCALE = 65_535


@dataclass(frozen=True)
class Orientation:
    """Mirror left and right first, then turn; ContractError: no angle of one turn."""

    # counter-clockwise as the marker image shows it, from 0 to below 360; taxels by quarters
    rotation_deg: float = 0
    flip: bool = False  # mirrored; for taxels whose columns run the other way, never for a camera

    def __post_init__(self) -> None:
        if not 0 <= self.rotation_deg < 360:
            do = "Give degrees, counter-clockwise."
            raise ContractError(
                expected("rotation_deg", "from 0 to below 360", self.rotation_deg, do)
            )

    def upright(self, raw: np.ndarray) -> np.ndarray:
        """Return (16, 3) uint16 counts, or a camera frame (H, W, 3), as if mounted straight."""
        return self.of_counts(raw) if raw.ndim == 2 else self.of_frame(raw)

    def of_counts(self, counts: np.ndarray) -> np.ndarray:
        """Return (16, 3) uint16 counts with taxels moved to their place and shear turned along.

        Counts are unsigned around mid-scale, so a reversed shear is mirrored there; differences to
        an equally turned reference come out exactly turned. By quarters only.
        """
        # rows from the bottom, columns from the left; x right, y up
        grid: np.ndarray = counts.reshape(SIDE, SIDE, 3).copy()
        if self.flip:
            grid = grid[:, ::-1].copy()
            grid[..., 0] = FULL_SCALE - grid[..., 0]
        for _ in range(round(self.rotation_deg / 90)):
            # rows run upwards: rot90's clockwise is the image's other way
            grid = np.rot90(grid, -1).copy()
            grid[..., 0], grid[..., 1] = FULL_SCALE - grid[..., 1], grid[..., 0].copy()
        return grid.reshape(TAXEL_SHAPE)

    def of_frame(self, frame: np.ndarray) -> np.ndarray:
        """Return a camera frame (H, W, 3) turned: by quarters exactly, else about its middle."""
        turned = frame[:, ::-1] if self.flip else frame
        if self.rotation_deg in TURNS:
            return np.ascontiguousarray(np.rot90(turned, round(self.rotation_deg / 90)))
        height, width = frame.shape[:2]
        turn = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), self.rotation_deg, 1.0)
        return cv2.warpAffine(
            np.ascontiguousarray(turned), turn, (width, height), borderMode=cv2.BORDER_REPLICATE
        )


SIDEWAYS = (90, 270)  # rotations that make rows of columns
# Hard limits of the checks for a dead sensor: no config disarms one, as in ``franka.limits``.
HARD_LIMITS = {
    "fps": Range(1, 1000),
    "max_age_ms": Range(0, 1000, above=True),
    "connect_ms": Range(0, 60_000, above=True),
    "frozen_after": Range(2, 100),
    "reference_samples": Range(3, 500),
}
FRAMES_PER_S = 30  # of a camera at most, for that: a stream's real rate isn't known


@dataclass(kw_only=True)
class SampledCameraConfig(CameraConfig):
    """Settings of every camera that is read in the background."""

    # camera frames per second; for taxels the robot loop's, their own rate is measured
    fps: int | None = 30
    source: str = ""  # where it is
    max_age_ms: float = 200.0  # an older sample is refused; 6 frames at 30 fps
    connect_ms: float = 5000.0  # the first sample must come within
    # equal samples in a row that mean a frozen sensor; 6 are .2 s at 30 fps
    frozen_after: int = 6
    # counter-clockwise, below 360; taxels by quarters. `uniforce touch` finds it, see above
    rotation_deg: float = 0.0

    def __post_init__(self) -> None:
        for name, allowed in HARD_LIMITS.items():
            if (value := getattr(self, name, None)) is not None:
                allowed.check(name, value)
        if not self.source:
            do = "Set source=/dev/v4l/by-path/… or http://…; for a uSkin its port or host:port."
            raise ContractError(expected("source", "a device", "nothing", do))

    @property
    def orientation(self) -> Orientation:
        """How it is turned on its mount."""
        return Orientation(self.rotation_deg, getattr(self, "flip", False))


@dataclass(kw_only=True)
class CapturedCameraConfig(SampledCameraConfig):
    """Settings of every USB camera or MJPEG stream.

    ``source`` is a device number, /dev/v4l/by-path/… (two C270s have no serial numbers), or
    http://…
    """

    # px asked of the camera; null takes what comes, as a stream needs
    capture_width: int | None = None
    capture_height: int | None = None
    fourcc: str | None = "MJPG"  # null leaves the camera's own
    # locked exposure, 100 µs units; null leaves the camera's automatic
    exposure_100us: float | None = None
    white_balance_K: float | None = None  # locked; null leaves it
    gain: float | None = None  # locked; null leaves it

    def __post_init__(self) -> None:
        super().__post_init__()
        # a frozen picture must be noticed within a second
        per_second = min(self.fps or FRAMES_PER_S, FRAMES_PER_S)
        Range(2, max(2, per_second)).check("frozen_after", self.frozen_after)

    @property
    def label(self) -> str:
        """How errors call it."""
        return "scene camera"

    @property
    def capture_size(self) -> tuple[int | None, int | None]:
        """(width, height) asked of the camera; its frames are turned after that."""
        return self.capture_width, self.capture_height


@dataclass(kw_only=True)
class TactileFingerConfig(SampledCameraConfig):
    """Settings of every tactile finger.

    ``width`` and ``height`` become those of the delivered image, as LeRobot expects of a camera.
    """

    finger: str = "left"  # left | right: which one it is mounted on; nothing is mirrored here
    check_identity: bool = True  # refuse another sensor than the configured one when connecting
    # take the free-air reference when connecting; needs open fingers
    reference_on_connect: bool = True
    reference_samples: int = 10  # samples it is the median of; touched while they come = refused
    sensor: str = ""  # registry name

    def __post_init__(self) -> None:
        super().__post_init__()
        check_finger(self.finger)
        self.spec = get_sensor(self.sensor)
        self.height, self.width = MARKER_IMAGE_SHAPE

    @property
    def label(self) -> str:
        """How errors call the sensor, e.g. ``tactip on the right finger``."""
        return f"{self.sensor} on the {self.finger} finger"


@CameraConfig.register_subclass("uniforce_tactile")
@dataclass(kw_only=True)
class UniforceTactileCameraConfig(TactileFingerConfig, CapturedCameraConfig):
    """A GelSight or TacTip behind a USB camera, or an MJPEG stream.

    Example: ``{"type": "uniforce_tactile", "sensor": "tactip", "finger": "right",
    "source": "/dev/v4l/by-path/…"}``
    """

    sensor: str = "gelsight"  # gelsight | tactip
    capture_width: int | None = 1280
    capture_height: int | None = 720
    exposure_100us: float | None = 100.0
    white_balance_K: float | None = 4600.0
    gain: float | None = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.spec.signal != "camera":
            raise ContractError(
                expected(
                    "sensor", "a camera sensor", self.sensor, "A patch of taxels is uniforce_uskin."
                )
            )

    @property
    def raw_shape(self) -> tuple[int, int, int]:
        """(rows, columns, 3) of the camera's upright frames; ContractError: no size was set."""
        if self.capture_width is None or self.capture_height is None:
            do = "A dataset needs to know the size of raw frames."
            raise ContractError(expected("capture_width, capture_height", "numbers", "null", do))
        if self.rotation_deg in SIDEWAYS:
            return self.capture_width, self.capture_height, 3
        return self.capture_height, self.capture_width, 3


@CameraConfig.register_subclass("uniforce_uskin")
@dataclass(kw_only=True)
class UniforceUskinConfig(TactileFingerConfig):
    """A 4×4 uSkin patch; delivers the marker image its counts are drawn as.

    ``source`` is a serial port or host:port, as ``link`` says.

    Example: ``{"type": "uniforce_uskin", "finger": "left", "link": "slcan",
    "source": "/dev/serial/by-id/…"}``
    """

    sensor: str = "uskin"
    link: str = "slcan"  # slcan: USB-CAN adapter | server: xela_server's WebSocket
    controller: int = 0  # microcontroller id in the low bits of the CAN ids
    server_sensor: str = "1"  # which sensor of the server's message
    flip: bool = False  # columns run the other way
    # .npy of (16, 3) free-air counts: shows a steady touch at the reference
    resting_level: str = ""
    max_age_ms: float = 100.0
    reference_samples: int = 50
    # scans, 0.3 s at the slowest rate seen; live taxels move by a few counts at rest
    frozen_after: int = 25

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.spec.raw_shape != TAXEL_SHAPE:
            do = "No driver of it is here: give its raw signal to Canonicalizer."
            raise ContractError(expected("sensor", "a patch of 4×4 taxels", self.sensor, do))
        require_one_of("link", self.link, ("slcan", "server"))
        require_one_of(
            "rotation_deg", self.rotation_deg, TURNS, "A grid of taxels turns by quarters."
        )


@CameraConfig.register_subclass("uniforce_scene")
@dataclass(kw_only=True)
class UniforceSceneCameraConfig(CapturedCameraConfig):
    """A scene camera: like LeRobot's ``opencv``, but stamped, reopened, and refused once frozen.

    ``width`` and ``height`` are those delivered: the captured frame's middle in this shape,
    resized.

    Example: ``{"type": "uniforce_scene", "source": "/dev/v4l/by-path/…", "width": 224,
    "height": 224, "capture_width": 640, "capture_height": 480}``
    """

    width: int | None = 640
    height: int | None = 480

    @property
    def capture_size(self) -> tuple[int | None, int | None]:
        """(width, height) asked of the camera before turning, by default as delivered."""
        if self.rotation_deg in SIDEWAYS:
            return self.capture_width or self.height, self.capture_height or self.width
        return self.capture_width or self.width, self.capture_height or self.height
