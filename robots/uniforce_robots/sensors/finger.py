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
from uniforce_robots.sensors.reader import SampleSource, Window
from uniforce_robots.sensors.sampled_camera import SampledCamera, make_frame_source
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
        self._lock = threading.Lock()  # the canonicalizer keeps state; two threads may ask
        self._reference: tuple[np.ndarray, np.ndarray] | None = None  # raw, and its image

    def connect(self, warmup: bool = True) -> None:
        """Open the device and wait for its first sample.

        Raises:
            SensorError: no device, no samples, another sensor than configured, or a reference taken in contact.
            DatasetError: one of LeRobot's recorders connects it and would store its images with loss.
        """
        delivers = getattr(self.config, "delivers", "markers")  # cameras may deliver raw frames
        refuse_lossy_recording(self.config.label, delivers == "markers")
        super().connect(warmup)

    @abstractmethod
    def _median(self, samples: list[np.ndarray]) -> np.ndarray:
        """Return one free-air signal of several, refusing what moved."""

    def _refuse_another_sensor(self) -> None:
        """Raise where what answers isn't what the config says; a subclass knows how to see it."""

    def _on_connect(self) -> None:
        if self.config.check_identity:
            self._refuse_another_sensor()
        if self.config.reference_on_connect:
            self.take_reference()

    def window(self, size: int, max_age_ms: float | None = None) -> Window:
        """Return the newest ``size`` samples, upright, the newest last; raises as ``read_latest``."""
        window = self._reader.window(size, self.config.max_age_ms if max_age_ms is None else max_age_ms)
        return replace(window, data=np.stack([self._orientation.upright(raw) for raw in window.data]))

    def take_reference(self) -> np.ndarray:
        """Take the free-air reference from the next samples; return its marker image (480, 640) uint8.

        Raises:
            SensorError: in contact as far as that can be known (see ``markers.reference``), lost, or without markers.
        """
        samples, index = [], -1
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
        """The free-air signal everything is compared with; ContractError before ``take_reference``."""
        return self._taken()[0]

    def reference_image(self) -> np.ndarray:
        """Return the reference's marker image, (480, 640, 3) uint8, for ``observation.images.tactile_*_ref``.

        The same array every time until the next reference, not writeable; ContractError before ``take_reference``.
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
    """GelSight and TacTip: a gel or dome behind a USB camera; see ``TactileFinger``.

    Args:
        config: what and where.
        factory: opens the camera; tests script one.
    """

    def __init__(self, config: UniforceTactileCameraConfig, factory: CaptureFactory = open_capture) -> None:
        super().__init__(config, make_frame_source(config, factory))

    def _refuse_another_sensor(self) -> None:
        centres_px = self._canonicalizer.markers(self.latest(self.config.connect_ms).raw)
        reason = why_not(self.config.spec, centres_px, self.config.label)
        if reason is not None:
            raise WrongSensorError(reason)

    def _image(self, upright: np.ndarray) -> np.ndarray:
        return upright if self.config.delivers == "raw" else super()._image(upright)

    def _median(self, samples: list[np.ndarray]) -> np.ndarray:
        return capture_camera_reference(samples, [self._canonicalizer.markers(frame) for frame in samples])


class UniforceUskin(TactileFinger):
    """A uSkin patch, its counts drawn as the marker image; see ``TactileFinger``.

    ``latest().raw`` is (16, 3) uint16 counts, before any baseline.

    Args:
        config: what and where.
        source: of such scans; None takes the one that ``config.link`` names.
    """

    capacity = 1024  # 2 s at 500 scans/s

    def __init__(self, config: UniforceUskinConfig, source: SampleSource | None = None) -> None:
        if source is None and config.link == "slcan":
            source = SlcanUSkin(config.source, config.label, config.controller)
        super().__init__(config, source or ServerUSkin(config.source, config.server_sensor, config.label))

    def _median(self, samples: list[np.ndarray]) -> np.ndarray:
        level = self.config.resting_level
        if level and not Path(level).is_file():
            do = "Save one with numpy.save, or leave it empty."
            raise ContractError(expected("resting_level", "a .npy file", level, do))
        return capture_taxel_reference(samples, resting_level=read_array(Path(level)) if level else None)


def _as_rgb(image: np.ndarray) -> np.ndarray:
    return np.repeat(image[..., None], 3, axis=2)
