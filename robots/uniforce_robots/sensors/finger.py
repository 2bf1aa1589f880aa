"""A tactile finger as a LeRobot camera, whatever its sensor: reader, free-air reference, canonical marker image.

What a dataset stores comes from here: the marker image as the sensor sees it (never mirrored), the raw signal beside
it, the time it was taken and its age.  A sensor that is lost, stale or frozen is an error, never an old or empty image.
"""

from __future__ import annotations

import threading
from abc import abstractmethod
from dataclasses import replace
from pathlib import Path

import numpy as np

from uniforce_robots.sensors.camera_source import CaptureFactory, open_capture
from uniforce_robots.sensors.config_uniforce import (
    TactileFingerConfig,
    UniforceTactileCameraConfig,
    UniforceUskinConfig,
)
from uniforce_robots.sensors.faults import WrongSensorError
from uniforce_robots.sensors.lossy_recording import refuse_lossy_recording
from uniforce_robots.sensors.sampled_camera import READ_MS, SampledCamera, make_frame_source
from uniforce_robots.sensors.samples import Sample, SampleSource, Window
from uniforce_robots.sensors.uskin_replay import ReplayUSkin
from uniforce_robots.sensors.uskin_server import ServerUSkin
from uniforce_robots.sensors.uskin_slcan import SlcanUSkin
from uniforce_vtla.array_file import read_array
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.identity import why_not
from uniforce_vtla.markers.reference import capture_camera_reference, capture_taxel_reference


class TactileFinger(SampledCamera):
    """A tactile sensor with LeRobot's camera interface.

    ``read``, ``async_read`` and ``read_latest`` return (480, 640, 3) uint8: the marker image, three equal channels.
    """

    def __init__(self, config: TactileFingerConfig, source: SampleSource) -> None:
        super().__init__(config, source)
        self._canonicalizer = Canonicalizer(config.sensor)
        self._lock = threading.Lock()  # the canonicaliser keeps state; two threads may ask
        self._drawn: tuple[int, np.ndarray] | None = None
        self._reference_raw: np.ndarray | None = None
        self._reference_drawn: np.ndarray | None = None

    def connect(self, warmup: bool = True) -> None:
        """Open the device and wait for its first sample.

        Raises:
            SensorError: no device, no samples, another sensor than configured, or a reference taken in contact.
            DatasetError: one of LeRobot's recorders connects it and would store its images with loss.
        """
        only_markers = (
            getattr(self.config, "delivers", "markers") == "markers"
        )  # cameras may deliver raw frames
        refuse_lossy_recording(self.config.label, only_markers)
        super().connect(warmup)

    @abstractmethod
    def _median(self, samples: list[np.ndarray]) -> np.ndarray:
        """Return one free-air signal of several, refusing what moved."""

    def _refuse_another_sensor(self) -> None:
        """Raise where what answers isn't what the config says; a subclass knows how to see it."""

    def _on_connect(self) -> None:
        self._drawn = None
        if self.config.check_identity:
            self._refuse_another_sensor()
        if self.config.reference_on_connect:
            self.take_reference()

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
            self._reference_raw, self._drawn, self._reference_drawn = reference, None, None
            return self._canonicalizer.marker_image(reference)

    @property
    def reference_raw(self) -> np.ndarray:
        """The free-air signal everything is compared with; ContractError before ``take_reference``."""
        if self._reference_raw is None:
            do = "Call take_reference() in free air."
            raise ContractError(expected(self.config.label, "a reference", "none", do))
        return self._reference_raw

    def reference_image(self) -> np.ndarray:
        """Return the reference's marker image, (480, 640, 3) uint8, for ``observation.images.tactile_*_ref``.

        The same array every time until the next reference: don't write to it.
        """
        with self._lock:
            if self._reference_drawn is None:
                self._reference_drawn = _as_rgb(self._canonicalizer.marker_image(self.reference_raw))
                self._reference_drawn.setflags(write=False)
            return self._reference_drawn

    def marker_image(self, raw: np.ndarray) -> np.ndarray:
        """Return the (480, 640) uint8 marker image of an upright raw sample."""
        with self._lock:
            return self._canonicalizer.marker_image(raw)

    def _image(self, sample: Sample) -> np.ndarray:
        with self._lock:
            if self._drawn is None or self._drawn[0] != sample.index:
                image = self._canonicalizer.marker_image(self._upright(sample.data))
                self._drawn = sample.index, _as_rgb(image)
            return self._drawn[1].copy()


class UniforceTactileCamera(TactileFinger):
    """GelSight and TacTip: a gel or dome behind a USB camera; see ``TactileFinger``.

    Args:
        config: what and where.
        capture_factory: opens the camera; tests script one.
    """

    def __init__(
        self, config: UniforceTactileCameraConfig, capture_factory: CaptureFactory = open_capture
    ) -> None:
        super().__init__(config, make_frame_source(config, capture_factory))

    def _refuse_another_sensor(self) -> None:
        centres_px = self._canonicalizer.markers(self.latest(self.config.connect_ms).raw)
        reason = why_not(self.config.spec, centres_px, self.config.label)
        if reason is not None:
            raise WrongSensorError(reason)

    def _image(self, sample: Sample) -> np.ndarray:
        return self._upright(sample.data) if self.config.delivers == "raw" else super()._image(sample)

    def _median(self, samples: list[np.ndarray]) -> np.ndarray:
        return capture_camera_reference(samples, [self._canonicalizer.markers(frame) for frame in samples])


class UniforceUskin(TactileFinger):
    """A uSkin patch, its counts drawn as the marker image; see ``TactileFinger``.

    ``latest().raw`` is (16, 3) uint16 counts.
    """

    capacity = 1024  # 2 s at 500 scans/s

    def __init__(self, config: UniforceUskinConfig) -> None:
        super().__init__(config, make_uskin_source(config))

    def upright_window(self, size: int) -> Window:
        """Return the newest ``size`` scans turned as ``latest`` turns them; raises as ``read_latest``."""
        window = self.window(size)
        return replace(window, data=np.stack([self._upright(scan) for scan in window.data]))

    def _upright(self, raw: np.ndarray) -> np.ndarray:
        return self._orientation.of_counts(raw)

    def _median(self, samples: list[np.ndarray]) -> np.ndarray:
        level = self.config.resting_level
        if not level:
            return capture_taxel_reference(samples)
        if not Path(level).is_file():
            do = "Save one with numpy.save, or leave it empty."
            raise ContractError(expected("resting_level", "a .npy file", level, do))
        return capture_taxel_reference(samples, resting_level=read_array(Path(level)))


def make_uskin_source(config: UniforceUskinConfig) -> SampleSource:
    """Return the source that ``config.link`` names; each sample is (16, 3) uint16 raw counts, before any baseline."""
    match config.link:
        case "slcan":
            ids = tuple(config.can_ids) or None
            return SlcanUSkin(config.source, ids, config.label, config.controller)
        case "server":
            return ServerUSkin(config.source, config.server_sensor, config.label)
        case _:
            return ReplayUSkin(config.source, config.replay_rate_hz, config.replay_loop, config.label)


def _as_rgb(image: np.ndarray) -> np.ndarray:
    return np.repeat(image[..., None], 3, axis=2)
