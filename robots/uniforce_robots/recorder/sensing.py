"""The newest of a robot's cameras and fingers, with its time; a sensor that isn't well is a DeviceError."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from lerobot.cameras import Camera

from uniforce_robots.recorder.faults import named
from uniforce_robots.recorder.plain_camera import PlainCamera
from uniforce_robots.recorder.rig import FingerTouch, Picture
from uniforce_robots.sensors.finger import SampledCamera, TactileFinger, UniforceUskin
from uniforce_robots.sensors.reader import NS_PER_S
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, SensorError, expected
from uniforce_vtla.keys import tactile_name

GARBAGE_OVER_s = 1.0
GARBAGE_MOST = (
    5  # bad pieces in that time: a few are a bad plug; a driver drops each, so nothing else shows them
)


class Sensing:
    """Reads what a robot lists as cameras.

    Args:
        cameras: by name; the fingers are ``tactile_left`` and ``tactile_right``, everything else looks at the scene.
        window: taxel scans kept per tick.
        keep_raw: whether raw tactile frames are wanted.

    Raises:
        ContractError: a finger without a tactile camera, or a camera of unknown age.
    """

    def __init__(self, cameras: Mapping[str, Camera], window: int, keep_raw: bool) -> None:
        self._window, self._keep_raw = window, keep_raw
        self._references: dict[Finger, np.ndarray] = {}
        self.fingers: dict[Finger, TactileFinger] = {f: _finger(cameras, f) for f in FINGERS}
        worn = {tactile_name(finger): device for finger, device in self.fingers.items()}
        self._scene: dict[str, SampledCamera | PlainCamera] = {
            name: camera if isinstance(camera, SampledCamera) else PlainCamera(name, camera)
            for name, camera in cameras.items()
            if name not in worn
        }
        self._sampled = {n: c for n, c in {**self._scene, **worn}.items() if isinstance(c, SampledCamera)}
        self._watches = {name: GarbageWatch(name) for name in self._sampled}

    def take_references(self) -> None:
        """Take every finger's free-air reference, and look whether every sensor is well.

        Raises:
            DeviceError: in contact as far as can be known, or not well.
        """
        for finger, device in self.fingers.items():
            with named("touch", tactile_name(finger)):
                self._references[finger] = device.take_reference()
        self.pictures()
        self.touches()

    def pictures(self) -> dict[str, Picture]:
        """Return the newest frame of each scene camera."""
        return {name: self._picture(name, camera) for name, camera in self._scene.items()}

    def touches(self) -> dict[Finger, FingerTouch]:
        """Return the newest of both fingers, the marker image of the very sample whose raw signal is beside it."""
        return {finger: self._touch(finger, device) for finger, device in self.fingers.items()}

    def summary(self) -> dict[str, Any]:
        """Return counts, rates and settings of every sensor read in the background."""
        return {name: _facts(device) for name, device in self._sampled.items()}

    def _picture(self, name: str, camera: SampledCamera | PlainCamera) -> Picture:
        with named("camera", name):
            if isinstance(camera, PlainCamera):
                return camera.picture()
            self._watches[name].look(time.monotonic(), camera.counts.bad)
            sample = camera.latest()
            return Picture(sample.raw, sample.index, sample.stamp_ns / NS_PER_S)

    def _touch(self, finger: Finger, device: TactileFinger) -> FingerTouch:
        with named("touch", name := tactile_name(finger)):
            self._watches[name].look(time.monotonic(), device.counts.bad)
            sample = device.latest()
            image, reference = device.marker_image(sample.raw), self._references[finger]
            window = _window(device, self._window) if isinstance(device, UniforceUskin) else ()
        raw = sample.raw if window or self._keep_raw else None
        return FingerTouch(image, reference, sample.index, sample.stamp_ns / NS_PER_S, raw, *window)


class GarbageWatch:
    """Watches a driver's count of pieces that it could not understand."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._seen: deque[tuple[float, int]] = deque()

    def look(self, now_s: float, bad: int) -> None:
        """Take the count so far; raise SensorError where more than ``GARBAGE_MOST`` came within a second."""
        self._seen.append((now_s, bad))
        while now_s - self._seen[0][0] > GARBAGE_OVER_s:
            self._seen.popleft()
        came = bad - self._seen[0][1]
        if came > GARBAGE_MOST:
            wanted = f"≤ {GARBAGE_MOST} bad pieces in {GARBAGE_OVER_s:g} s"
            do = "Check cable, power and what else is on the bus."
            raise SensorError(expected(self._name, wanted, came, do))


def _finger(cameras: Mapping[str, Camera], finger: Finger) -> TactileFinger:
    name = tactile_name(finger)
    device = cameras.get(name)
    if not isinstance(device, TactileFinger) or device.config.finger != finger:
        came = "none" if device is None else f"{type(device).__name__} for {getattr(device, 'config', None)}"
        do = f"List it in the robot's cameras, with finger={finger}."
        raise ContractError(expected(name, "a uniforce_tactile or uniforce_uskin camera", came, do))
    return device


def _window(device: UniforceUskin, size: int) -> tuple[np.ndarray, np.ndarray]:
    stamps_ns, scans = device.window(size)
    return scans, stamps_ns / NS_PER_S


def _facts(device: SampledCamera) -> dict[str, Any]:
    counts = device.counts
    return {
        "rate_hz": round(device.rate_hz, 2),
        "samples": counts.samples,
        "lost": counts.lost,
        "bad": counts.bad,
        "reconnects": device.reconnects,
        "settings": device.settings_read_back,
    }
