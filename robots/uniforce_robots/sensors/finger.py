"""Scene cameras and tactile fingers, read in the background, as LeRobot cameras.

device → ``SampleReader`` → for a finger: free-air reference, canonical marker image. A dataset
stores the marker image as the sensor sees it (never mirrored), the raw signal, its time and its
age. A sensor that is lost, stale or frozen is an error, never an old or empty image.
"""

import threading
from abc import abstractmethod
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from lerobot.cameras.camera import Camera

from uniforce_robots.sensors.camera_source import CameraSource, CaptureFactory, open_capture
from uniforce_robots.sensors.config_uniforce import (
    CapturedCameraConfig,
    SampledCameraConfig,
    TactileFingerConfig,
    UniforceSceneCameraConfig,
    UniforceTactileCameraConfig,
    UniforceUskinConfig,
)
from uniforce_robots.sensors.faults import WrongSensorError
from uniforce_robots.sensors.lossy_recording import refuse_lossy_recording
from uniforce_robots.sensors.mjpeg import StreamSource
from uniforce_robots.sensors.reader import (
    ReaderLimits,
    Sample,
    SampleReader,
    SampleSource,
    SourceCounts,
)
from uniforce_robots.sensors.uskin_server import ServerUSkin
from uniforce_robots.sensors.uskin_slcan import SlcanUSkin
from uniforce_vtla.array_file import read_array
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.identity import why_not
from uniforce_vtla.markers.reference import capture_camera_reference, capture_taxel_reference

READ_MS = 1000.0  # ``read`` waits this long for the next sample


class SampledCamera(Camera):
    """Reads ``source`` in the background; a subclass says what its image is."""

    capacity = 8  # samples kept; a subclass with small samples keeps more

    def __init__(self, config: SampledCameraConfig, source: SampleSource) -> None:
        super().__init__(config)
        self.config: Any = config
        self._source = source
        self._reader = SampleReader(
            source, ReaderLimits(self.capacity, config.frozen_after, config.connect_ms)
        )
        self._orientation = config.orientation
        self._last_index = -1

    @abstractmethod
    def _image(self, upright: np.ndarray) -> np.ndarray:
        """Return the image of an upright raw sample."""

    def _on_connect(self) -> None:
        """Do what has to be done with the first sample there; an error lets the device go."""

    @property
    def is_connected(self) -> bool:
        """Whether it is being read; whether it is alive, only a sample can tell."""
        return self._reader.is_running

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return the video devices of this machine, each with the path that survives a reboot."""
        paths = sorted(Path("/dev/v4l/by-path").glob("*"))
        return [{"type": "uniforce_tactile", "id": str(path), "name": path.name} for path in paths]

    def connect(self, warmup: bool = True) -> None:
        """Open the device and wait for its first sample.

        Raises SensorError: no device, no samples, another sensor, or a reference in contact.
        """
        if self.is_connected:
            return
        self._reader.start()
        self._last_index = -1
        with ExitStack() as undo:
            undo.callback(self._reader.stop)
            self._on_connect()
            undo.pop_all()

    def disconnect(self) -> None:
        """Stop reading and let go of the device."""
        self._reader.stop()

    def read(self) -> np.ndarray:
        """Wait for the next sample; return its image. Raises as ``read_latest``."""
        return self.async_read(READ_MS)

    def async_read(self, timeout_ms: float = 200.0) -> np.ndarray:
        """Wait for a sample not delivered before; return its image. Raises as ``read_latest``."""
        sample = self.next_touch(self._last_index, timeout_ms)
        self._last_index = sample.index
        return self._image(sample.raw)

    def read_latest(self, max_age_ms: float | None = None) -> np.ndarray:
        """Return the newest sample's image at once; None takes the config's ``max_age_ms``.

        Raises StaleSensorError: older than that, or none yet (also a TimeoutError);
        LostSensorError: not connected or unplugged (also a ConnectionError); FrozenSensorError: the
        content stopped changing; SensorError: no markers in the frame, or taxels all zero;
        ContractError: taxels without a reference.
        """
        return self._image(self.latest(max_age_ms).raw)

    def latest(self, max_age_ms: float | None = None) -> Sample:
        """Return the newest raw sample, upright, with time and age; raises as ``read_latest``."""
        if max_age_ms is None:
            max_age_ms = self.config.max_age_ms
        return self._upright(self._reader.newest(max_age_ms))

    def next_touch(self, after: int, timeout_ms: float = READ_MS) -> Sample:
        """Wait for and return a raw sample after index ``after``; raises as ``read_latest``."""
        return self._upright(self._reader.wait_newer(after, timeout_ms))

    @property
    def rate_hz(self) -> float:
        """The measured rate of the last two seconds."""
        return self._reader.rate_hz()

    @property
    def counts(self) -> SourceCounts:
        """Samples, lost and bad ones so far."""
        return self._reader.counts

    @property
    def reconnects(self) -> int:
        """How often the device was lost and found again."""
        return self._reader.reconnects

    @property
    def settings_read_back(self) -> dict[str, float]:
        """Settings reported by a camera's driver when it was opened; else empty."""
        return self._source.settings_read_back

    def _upright(self, sample: Sample) -> Sample:
        return replace(sample, raw=self._orientation.upright(sample.raw))


class TactileFinger(SampledCamera):
    """A tactile sensor with LeRobot's camera interface.

    ``read``, ``async_read`` and ``read_latest`` return the marker image, (480, 640, 3) uint8, its
    channels equal.
    """

    def __init__(self, config: TactileFingerConfig, source: SampleSource) -> None:
        super().__init__(config, source)
        self._canonicalizer = Canonicalizer(config.sensor, stream=True)
        self._lock = threading.Lock()  # the canonicalizer keeps state; two threads may ask
        self._reference: tuple[np.ndarray, np.ndarray] | None = None  # raw, and its image

    def connect(self, warmup: bool = True) -> None:
        """Open the device and wait for its first sample.

        Raises SensorError: no device, no samples, another sensor, or a reference in contact;
        DatasetError: one of LeRobot's recorders connects it and would store its images with loss.
        """
        refuse_lossy_recording(self.config.label)
        super().connect(warmup)

    @abstractmethod
    def _median(self, samples: list[np.ndarray]) -> np.ndarray:
        """Return one free-air signal of several, refusing what moved."""

    def _on_connect(self) -> None:
        if self.config.reference_on_connect:
            self.take_reference()

    def window(self, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Return stamps (size,) ns and upright data (size, ...); see ``SampleReader.window``."""
        stamps_ns, data = self._reader.window(size, self.config.max_age_ms)
        return stamps_ns, np.stack([self._orientation.upright(raw) for raw in data])

    def take_reference(self) -> np.ndarray:
        """Take the free-air reference; return its marker image (480, 640) uint8.

        Raises SensorError: in contact as far as that can be known (see ``markers.reference``),
        lost, or without markers.
        """
        samples = []
        index = -1
        for _ in range(self.config.reference_samples):
            sample = self.next_touch(index)
            samples.append(sample.raw)
            index = sample.index
        raw = self._median(samples)
        with self._lock:
            self._canonicalizer.set_reference(raw)
            image = self._canonicalizer.marker_image(raw)
            self._reference = raw, _as_rgb(image)
            self._reference[1].setflags(write=False)
        return image

    @property
    def reference_raw(self) -> np.ndarray:
        """The free-air signal; ContractError before ``take_reference``."""
        return self._taken()[0]

    def reference_image(self) -> np.ndarray:
        """Return the reference's marker image, (480, 640, 3) uint8, for ``…tactile_*_ref``.

        The same array until the next reference, not writeable; ContractError before
        ``take_reference``.
        """
        return self._taken()[1]

    def marker_image(self, raw: np.ndarray) -> np.ndarray:
        """Return the (480, 640) uint8 marker image of an upright raw sample."""
        with self._lock:
            return self._canonicalizer.marker_image(raw)

    def _image(self, upright: np.ndarray) -> np.ndarray:
        return _as_rgb(self.marker_image(upright))

    def _taken(self) -> tuple[np.ndarray, np.ndarray]:
        if self._reference is None:
            do = "Call take_reference() in free air."
            raise ContractError(expected(self.config.label, "a reference", "none", do))
        return self._reference


class UniforceTactileCamera(TactileFinger):
    """GelSight and TacTip: a gel or dome behind a USB camera, which ``factory`` opens."""

    def __init__(
        self, config: UniforceTactileCameraConfig, factory: CaptureFactory = open_capture
    ) -> None:
        super().__init__(config, make_frame_source(config, factory))

    def _on_connect(self) -> None:
        if self.config.check_identity:
            centres_px = self._canonicalizer.markers(self.latest(self.config.connect_ms).raw)
            reason = why_not(self.config.spec, centres_px, self.config.label)
            if reason is not None:
                raise WrongSensorError(reason)
        super()._on_connect()

    def _median(self, samples: list[np.ndarray]) -> np.ndarray:
        return capture_camera_reference(
            samples, [self._canonicalizer.markers(frame) for frame in samples]
        )


class UniforceUskin(TactileFinger):
    """A uSkin patch, its counts drawn as the marker image; see ``TactileFinger``.

    ``latest().raw`` is (16, 3) uint16 counts before any baseline, from ``source`` or
    ``config.link``.
    """

    capacity = 1024  # 2 s at 500 scans/s

    def __init__(self, config: UniforceUskinConfig, source: SampleSource | None = None) -> None:
        if source is None and config.link == "slcan":
            source = SlcanUSkin(config.source, config.label, config.controller)
        super().__init__(
            config, source or ServerUSkin(config.source, config.server_sensor, config.label)
        )

    def _median(self, samples: list[np.ndarray]) -> np.ndarray:
        level = self.config.resting_level
        if not level:
            return capture_taxel_reference(samples, resting_level=None)
        if not Path(level).is_file():
            do = "Save one with numpy.save, or leave it empty."
            raise ContractError(expected("resting_level", "a .npy file", level, do))
        return capture_taxel_reference(samples, resting_level=read_array(Path(level)))


def _as_rgb(image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)  # np.repeat takes twenty times as long


class UniforceSceneCamera(SampledCamera):
    """A scene camera; delivers (height, width, 3) uint8 RGB; ``factory`` opens it."""

    def __init__(
        self, config: UniforceSceneCameraConfig, factory: CaptureFactory = open_capture
    ) -> None:
        super().__init__(config, make_frame_source(config, factory))

    def _image(self, upright: np.ndarray) -> np.ndarray:
        return upright

    def _upright(self, sample: Sample) -> Sample:
        width = self.width
        height = self.height
        turned = super()._upright(sample)
        if width is None or height is None or turned.raw.shape[:2] == (height, width):
            return turned
        part = middle(turned.raw, width / height)
        small = cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA)
        return replace(turned, raw=small)


def make_frame_source(config: CapturedCameraConfig, factory: CaptureFactory) -> SampleSource:
    """Return the source that ``config.source`` names: a stream or a device."""
    if config.source.startswith(("http://", "https://")):
        return StreamSource(config)
    return CameraSource(config, factory)


def middle(image: np.ndarray, aspect: float) -> np.ndarray:
    """Return the largest middle part of an (H, W, 3) image, ``aspect`` times as wide as high."""
    rows, columns = image.shape[:2]
    width = min(columns, round(rows * aspect))
    height = min(rows, round(columns / aspect))
    left = (columns - width) // 2
    top = (rows - height) // 2
    return image[top : top + height, left : left + width]
