"""GelSight and TacTip: a gel or dome behind a USB camera."""

from __future__ import annotations

from typing import cast

import numpy as np

from uniforce_robots.sensors.camera_source import CameraSource, Clock
from uniforce_robots.sensors.capture import CaptureFactory, open_capture
from uniforce_robots.sensors.config_uniforce import UniforceTactileCameraConfig
from uniforce_robots.sensors.faults import WrongSensorError
from uniforce_robots.sensors.finger import TactileFinger
from uniforce_robots.sensors.samples import Sample
from uniforce_vtla.markers.identity import why_not


class UniforceTactileCamera(TactileFinger):
    """A camera-based tactile finger; see ``TactileFinger``.

    Args:
        config: what and where.
        capture_factory: opens the camera; tests script one.
    """

    def __init__(
        self, config: UniforceTactileCameraConfig, capture_factory: CaptureFactory = open_capture
    ) -> None:
        self._camera = CameraSource(
            config.source,
            config.capture_settings(),
            config.label,
            cast("Clock", config.clock),
            capture_factory,
        )
        self._delivers_raw = config.delivers == "raw"
        super().__init__(config)

    def _make_source(self) -> CameraSource:
        return self._camera

    def _refuse_another_sensor(self) -> None:
        centres_px = self._canonicalizer.markers(self.latest(self.config.connect_ms).raw)
        reason = why_not(self.config.spec, centres_px, self.config.label)
        if reason is not None:
            raise WrongSensorError(reason)

    @property
    def settings_read_back(self) -> dict[str, float]:
        """Every setting as the driver reported it when the camera was opened; empty for a stream."""
        return dict(self._camera.settings_read_back)

    def _image(self, sample: Sample) -> np.ndarray:
        return self._upright(sample.data) if self._delivers_raw else super()._image(sample)
