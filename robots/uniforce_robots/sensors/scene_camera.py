"""A camera that looks at the scene, read as the tactile ones are: newest frame with its time, or an error."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np

from uniforce_robots.sensors.camera_source import CameraSource, Clock
from uniforce_robots.sensors.capture import CaptureFactory, open_capture
from uniforce_robots.sensors.config_uniforce import UniforceSceneCameraConfig
from uniforce_robots.sensors.sampled_camera import SampledCamera
from uniforce_robots.sensors.samples import Sample


class UniforceSceneCamera(SampledCamera):
    """Delivers (height, width, 3) uint8 RGB.

    Args:
        config: what and where.
        capture_factory: opens the camera; tests script one.
    """

    def __init__(
        self, config: UniforceSceneCameraConfig, capture_factory: CaptureFactory = open_capture
    ) -> None:
        settings, clock = config.capture_settings(), cast("Clock", config.clock)
        self._camera = CameraSource(config.source, settings, config.label, clock, capture_factory)
        super().__init__(config)
        self._size = config.width, config.height

    def _make_source(self) -> CameraSource:
        return self._camera

    def _image(self, sample: Sample) -> np.ndarray:
        return self._upright(sample.data)

    def _upright(self, raw: np.ndarray) -> np.ndarray:
        width, height = self._size
        turned = super()._upright(raw)
        if width is None or height is None or turned.shape[:2] == (height, width):
            return turned
        return cv2.resize(middle(turned, width / height), (width, height), interpolation=cv2.INTER_AREA)

    @property
    def settings_read_back(self) -> dict[str, float]:
        """Every setting as the driver reported it when the camera was opened; empty for a stream."""
        return dict(self._camera.settings_read_back)


def middle(image: np.ndarray, aspect: float) -> np.ndarray:
    """Return the largest middle part of an (H, W, 3) image that is ``aspect`` times as wide as high."""
    rows, columns = image.shape[:2]
    width, height = min(columns, round(rows * aspect)), min(rows, round(columns / aspect))
    left, top = (columns - width) // 2, (rows - height) // 2
    return image[top : top + height, left : left + width]
