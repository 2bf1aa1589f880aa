"""A LeRobot camera whose frames come from a ``SampleReader``: stamped, aged, and never an old one in silence."""

from __future__ import annotations

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
    UniforceSceneCameraConfig,
)
from uniforce_robots.sensors.mjpeg import StreamSource
from uniforce_robots.sensors.reader import ReaderLimits, Sample, SampleReader, SampleSource, SourceCounts

READ_MS = 1000.0  # ``read`` waits this long for the next sample


class SampledCamera(Camera):
    """Reads ``source`` in the background; a subclass says what its image is."""

    capacity = 8  # samples kept; a subclass with small samples keeps more

    def __init__(self, config: SampledCameraConfig, source: SampleSource) -> None:
        super().__init__(config)
        self.config: Any = config
        self._source = source
        limits = ReaderLimits(self.capacity, config.frozen_after, config.connect_ms)
        self._reader = SampleReader(source, limits)
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

        Raises:
            SensorError: no device, no samples, another sensor than configured, or a reference taken in contact.
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
        """Return the image of a sample not delivered before, waiting for it; raises as ``read_latest``."""
        sample = self.next_touch(self._last_index, timeout_ms)
        self._last_index = sample.index
        return self._image(sample.raw)

    def read_latest(self, max_age_ms: float | None = None) -> np.ndarray:
        """Return the newest sample's image at once.

        Args:
            max_age_ms: the oldest that is good enough; None takes the config's.

        Raises:
            StaleSensorError: older than that, or none yet (also a TimeoutError).
            LostSensorError: not connected or unplugged (also a ConnectionError).
            FrozenSensorError: the content stopped changing.
            SensorError: no markers in the frame, or taxels all zero.
            ContractError: taxels without a reference.
        """
        return self._image(self.latest(max_age_ms).raw)

    def latest(self, max_age_ms: float | None = None) -> Sample:
        """Return the newest raw sample, upright, with its time and age; raises as ``read_latest``."""
        limit_ms = self.config.max_age_ms if max_age_ms is None else max_age_ms
        return self._upright(self._reader.newest(limit_ms))

    def next_touch(self, after: int, timeout_ms: float = READ_MS) -> Sample:
        """Return the newest raw sample after index ``after``, waiting for it; raises as ``read_latest``."""
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
        """What a camera's driver said its settings were when it was opened, for a dataset; else empty."""
        return self._source.settings_read_back

    def _upright(self, sample: Sample) -> Sample:
        return replace(sample, raw=self._orientation.upright(sample.raw))


class UniforceSceneCamera(SampledCamera):
    """A camera that looks at the scene; delivers (height, width, 3) uint8 RGB.

    Args:
        config: what and where.
        factory: opens the camera; tests script one.
    """

    def __init__(self, config: UniforceSceneCameraConfig, factory: CaptureFactory = open_capture) -> None:
        super().__init__(config, make_frame_source(config, factory))
        self._size = config.width, config.height

    def _image(self, upright: np.ndarray) -> np.ndarray:
        return upright

    def _upright(self, sample: Sample) -> Sample:
        (width, height), turned = self._size, super()._upright(sample)
        if width is None or height is None or turned.raw.shape[:2] == (height, width):
            return turned
        small = cv2.resize(middle(turned.raw, width / height), (width, height), interpolation=cv2.INTER_AREA)
        return replace(turned, raw=small)


def make_frame_source(config: CapturedCameraConfig, factory: CaptureFactory) -> SampleSource:
    """Return the source that ``config.source`` names: a stream or a device."""
    is_stream = config.source.startswith(("http://", "https://"))
    return StreamSource(config) if is_stream else CameraSource(config, factory)


def middle(image: np.ndarray, aspect: float) -> np.ndarray:
    """Return the largest middle part of an (H, W, 3) image that is ``aspect`` times as wide as high."""
    rows, columns = image.shape[:2]
    width, height = min(columns, round(rows * aspect)), min(rows, round(columns / aspect))
    left, top = (columns - width) // 2, (rows - height) // 2
    return image[top : top + height, left : left + width]
