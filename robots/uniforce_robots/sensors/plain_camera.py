"""LeRobot's own cameras, watched: an old, frozen or broken frame is an error, never a picture.

They keep the newest frame and when it came (``latest_timestamp``, ``time.perf_counter``). They
don't notice a picture that stopped changing, and call themselves connected when their thread has
died.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.cameras import Camera

from uniforce_robots.sensors.faults import FrozenSensorError, LostSensorError, StaleSensorError
from uniforce_vtla.errors import ContractError, SensorError, expected

MAX_AGE_ms = 200  # an older frame is refused
FROZEN_AFTER = 6  # frames of one content in a row mean a frozen camera: .2 s at 30 a second
TRIES = 5  # a frame that comes between the two looks at its stamp; twice in a row is rare already
STRIDE = 4  # every 4th row and column is enough to see whether a noisy picture changed
DO = "Check cable, power and USB load."


@dataclass(frozen=True)
class Picture:
    """A scene camera's newest frame."""

    image: np.ndarray  # (H, W, 3) uint8 RGB
    index: int  # its number since connecting
    time_s: float  # when it was taken


class PlainCamera:
    """Read any LeRobot camera with a ``latest_timestamp``; ContractError: it has none."""

    def __init__(self, name: str, camera: Camera) -> None:
        if not hasattr(camera, "latest_timestamp"):
            do = "Use uniforce_scene, opencv, intelrealsense or zmq."
            raise ContractError(
                expected(name, "a camera with latest_timestamp", type(camera).__name__, do)
            )
        self._name = name
        self._camera = camera
        self._index = -1
        self._time_s = float("nan")
        self._repeats = 0
        self._last: np.ndarray = np.zeros(0)

    def picture(self) -> Picture:
        """Return the newest frame.

        Raises StaleSensorError: it is too old; LostSensorError: the camera's thread has ended, or
        it is disconnected; FrozenSensorError: the content hasn't changed for ``FROZEN_AFTER``
        frames; SensorError: it is no picture.
        """
        image, time_s = self._newest()
        if time_s != self._time_s:
            self._index += 1
            self._time_s = time_s
            thinned = image[::STRIDE, ::STRIDE].copy()
            if np.array_equal(thinned, self._last):
                self._repeats += 1
            else:
                self._repeats = 0
            self._last = thinned
        if self._repeats >= FROZEN_AFTER:
            came = f"the same content {self._repeats + 1} times in a row"
            raise FrozenSensorError(
                expected(self._name, "changing frames", came, "Replug the camera.")
            )
        return Picture(image, self._index, time_s)

    def _newest(self) -> tuple[np.ndarray, float]:
        camera: Any = self._camera
        try:
            for _ in range(TRIES):
                before = camera.latest_timestamp
                image = camera.read_latest(max_age_ms=MAX_AGE_ms)
                if before is not None and before == camera.latest_timestamp:
                    return self._checked(image), float(before)
        except SensorError:
            raise
        except TimeoutError as error:
            raise StaleSensorError(expected(self._name, "a fresh frame", error, DO)) from error
        except Exception as error:  # foreign code, which may raise anything
            raise LostSensorError(
                expected(self._name, "a running camera", repr(error), DO)
            ) from error
        raise StaleSensorError(
            expected(self._name, "a frame that holds still", "none", "Lower its rate.")
        )

    def _checked(self, image: Any) -> np.ndarray:
        shape = getattr(image, "shape", None)
        kind = getattr(image, "dtype", None)
        if kind != np.uint8 or shape != (self._camera.height, self._camera.width, 3):
            wanted = f"({self._camera.height}, {self._camera.width}, 3) uint8"
            came = f"{shape} {kind}" if shape else type(image).__name__
            raise SensorError(expected(self._name, wanted, came, "Check its settings."))
        return image
