"""A tactile finger as a LeRobot camera, whatever its sensor: reader, free-air reference, canonical marker image.

What a dataset stores comes from here: the marker image as the sensor sees it (never mirrored), the raw signal beside
it, the time it was taken and its age.  A sensor that is lost, stale or frozen is an error, never an old or empty image.
"""

from __future__ import annotations

import contextlib
import threading
from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.cameras.camera import Camera

from lerobot_camera_uniforce.config_uniforce import TactileFingerConfig
from lerobot_camera_uniforce.reader import ReaderLimits, SampleReader
from lerobot_camera_uniforce.samples import Sample, Window
from lerobot_camera_uniforce.sources import SampleSource, SourceCounts
from uniforce_vtla.array_file import read_array
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.reference import capture_camera_reference, capture_taxel_reference

READ_MS = 1000.0  # ``read`` waits this long for the next sample


@dataclass(frozen=True)
class Touch:
    """One sample of a finger.

    Attributes:
        raw: (H, W, 3) uint8 RGB or (16, 3) uint16 counts, upright.
        index: of the sample since connecting; a gap tells how many were left out.
        stamp_ns: when it was taken, host's monotonic clock.
        age_ms: how old it was when asked for.
    """

    raw: np.ndarray
    index: int
    stamp_ns: int
    age_ms: float


class TactileFinger(Camera):
    """A tactile sensor with LeRobot's camera interface.

    ``read``, ``async_read`` and ``read_latest`` return (480, 640, 3) uint8: the marker image, three equal channels.
    """

    capacity = 8  # samples kept; a subclass with small samples keeps more

    def __init__(self, config: TactileFingerConfig) -> None:
        super().__init__(config)
        self.config = config
        self._canonicalizer = Canonicalizer(config.sensor)
        self._source = self._make_source()
        self._reader = SampleReader(self._source, ReaderLimits(self.capacity, config.frozen_after))
        self._orientation = config.orientation
        self._lock = threading.Lock()  # the canonicaliser keeps state; two threads may ask
        self._drawn: tuple[int, np.ndarray] | None = None
        self._reference_raw: np.ndarray | None = None
        self._last_index = -1

    @abstractmethod
    def _make_source(self) -> SampleSource: ...

    # -- LeRobot's camera -------------------------------------------------------------------------------

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
        """Open the device, wait for its first sample, and take the free-air reference if the config says so.

        Raises:
            SensorError: no device, no samples, another sensor than configured, or a reference taken in contact.
        """
        if self.is_connected:
            return
        self._reader.start()
        self._last_index, self._drawn = -1, None
        with contextlib.ExitStack() as undo:
            undo.callback(self._reader.stop)  # a half-connected device would keep its port
            self._reader.wait_newer(-1, self.config.connect_ms)
            if self.config.reference_on_connect:
                self.take_reference()
            undo.pop_all()

    def disconnect(self) -> None:
        """Stop reading and let go of the device."""
        self._reader.stop()

    def read(self) -> np.ndarray:
        """Wait for the next sample; return its image. Raises as ``read_latest``."""
        return self.async_read(READ_MS)

    def async_read(self, timeout_ms: float = 200.0) -> np.ndarray:
        """Return the image of a sample not delivered before, waiting for it; raises as ``read_latest``."""
        sample = self._reader.wait_newer(self._last_index, timeout_ms)
        self._last_index = sample.index
        return self._image(sample)

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
        return self._image(self._reader.newest(self._age_limit(max_age_ms)))

    # -- beyond LeRobot's camera ------------------------------------------------------------------------

    def latest(self, max_age_ms: float | None = None) -> Touch:
        """Return the newest raw sample with its time and age; raises as ``read_latest``."""
        sample = self._reader.newest(self._age_limit(max_age_ms))
        return Touch(self._upright(sample.data), sample.index, sample.stamp_ns, sample.age_ms())

    def next_touch(self, after: int, timeout_ms: float = READ_MS) -> Touch:
        """Return the newest raw sample after index ``after``, waiting for it; raises as ``read_latest``."""
        sample = self._reader.wait_newer(after, timeout_ms)
        return Touch(self._upright(sample.data), sample.index, sample.stamp_ns, sample.age_ms())

    def window(self, size: int, max_age_ms: float | None = None) -> Window:
        """Return the newest ``size`` samples as the device sent them; raises as ``read_latest``."""
        return self._reader.window(size, self._age_limit(max_age_ms))

    def since(self, index: int) -> Window:
        """Return every kept sample after ``index`` as the device sent it, for a recorder that wants them all."""
        return self._reader.since(index)

    def take_reference(self) -> np.ndarray:
        """Take the free-air reference from the next samples; return its marker image (480, 640) uint8.

        Raises:
            SensorError: in contact as far as that can be known (see ``markers.reference``), lost, or without markers.
        """
        samples, index = [], -1
        for _ in range(self.config.reference_samples):
            sample = self._reader.wait_newer(index, READ_MS)
            samples.append(self._upright(sample.data))
            index = sample.index
        reference = self._median(samples)
        with self._lock:
            self._canonicalizer.set_reference(reference)
            self._reference_raw, self._drawn = reference, None
            return self._canonicalizer.marker_image(reference)

    @property
    def reference_raw(self) -> np.ndarray:
        """The free-air signal everything is compared with; ContractError before ``take_reference``."""
        if self._reference_raw is None:
            do = "Call take_reference() in free air."
            raise ContractError(expected(self.config.label, "a reference", "none", do))
        return self._reference_raw

    def reference_image(self) -> np.ndarray:
        """Return the reference's marker image, (480, 640, 3) uint8, for ``observation.images.tactile_*_ref``."""
        with self._lock:
            return _as_rgb(self._canonicalizer.marker_image(self.reference_raw))

    def marker_image(self, raw: np.ndarray) -> np.ndarray:
        """Return the (480, 640) uint8 marker image of an upright raw sample."""
        with self._lock:
            return self._canonicalizer.marker_image(raw)

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
        """What the device says its settings are, to be stored with a dataset; empty where it has none."""
        return {}

    # -- inside -----------------------------------------------------------------------------------------

    def _image(self, sample: Sample) -> np.ndarray:
        with self._lock:
            if self._drawn is None or self._drawn[0] != sample.index:
                image = self._canonicalizer.marker_image(self._upright(sample.data))
                self._drawn = sample.index, _as_rgb(image)
            return self._drawn[1].copy()

    def _upright(self, raw: np.ndarray) -> np.ndarray:
        return self._orientation.of_frame(raw)

    def _median(self, samples: list[np.ndarray]) -> np.ndarray:
        """Return one free-air signal of several, refusing what moved."""
        centres = [self._canonicalizer.markers(frame) for frame in samples]
        return capture_camera_reference(samples, centres)

    def _age_limit(self, max_age_ms: float | None) -> float:
        return self.config.max_age_ms if max_age_ms is None else max_age_ms


def taxel_median(scans: list[np.ndarray], resting_level: str) -> np.ndarray:
    """Return (16, 3) int64 of several free-air scans; ``resting_level`` names a .npy of known free air, or nothing.

    Raises:
        SensorError: in contact.
        ContractError: no such file, or not (16, 3) counts.
    """
    if not resting_level:
        return capture_taxel_reference(scans)
    if not Path(resting_level).is_file():
        do = "Save one with numpy.save, or leave it empty."
        raise ContractError(expected("resting_level", "a .npy file", resting_level, do))
    return capture_taxel_reference(scans, resting_level=read_array(Path(resting_level)))


def _as_rgb(image: np.ndarray) -> np.ndarray:
    return np.repeat(image[..., None], 3, axis=2)
