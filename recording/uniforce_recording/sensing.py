"""The newest of a robot's cameras and fingers, with its time; a sensor that isn't well is a DeviceError."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
from lerobot.cameras import Camera

from lerobot_camera_uniforce.finger import TactileFinger
from lerobot_camera_uniforce.sampled_camera import SampledCamera
from lerobot_camera_uniforce.samples import NS_PER_S
from lerobot_camera_uniforce.uskin_camera import UniforceUskin
from uniforce_recording.faults import device_fault
from uniforce_recording.garbage_watch import GarbageWatch
from uniforce_recording.observation import FingerTouch, Picture, ScanWindow
from uniforce_recording.plain_camera import PlainCamera
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, SensorError, expected
from uniforce_vtla.keys import tactile_name


@contextmanager
def named(kind: Literal["camera", "touch"], device: str) -> Iterator[None]:
    """Turn a sensor's error into the fault of a device with a name."""
    try:
        yield
    except SensorError as error:
        raise device_fault(kind, device, error) from error


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
        self._watches: dict[str, GarbageWatch] = {}
        self.fingers: dict[Finger, TactileFinger] = {f: _finger(cameras, f) for f in FINGERS}
        worn = {tactile_name(finger) for finger in FINGERS}
        scene = {name: camera for name, camera in cameras.items() if name not in worn}
        self._scene = {
            name: camera if isinstance(camera, SampledCamera) else PlainCamera(name, camera)
            for name, camera in scene.items()
        }

    def take_references(self) -> None:
        """Take every finger's free-air reference.

        Raises:
            DeviceError: in contact as far as can be known, or not well.
        """
        for finger, device in self.fingers.items():
            with named("touch", tactile_name(finger)):
                self._references[finger] = device.take_reference()

    def pictures(self) -> dict[str, Picture]:
        """Return the newest frame of each scene camera."""
        return {name: self._picture(name, camera) for name, camera in self._scene.items()}

    def touches(self) -> dict[Finger, FingerTouch]:
        """Return what both fingers feel, the marker image of the very sample whose raw signal is beside it."""
        return {finger: self._touch(finger, device) for finger, device in self.fingers.items()}

    def summary(self) -> dict[str, Any]:
        """Return counts, rates and settings of every sensor read in the background."""
        ours = {name: camera for name, camera in self._scene.items() if isinstance(camera, SampledCamera)}
        ours |= {tactile_name(finger): device for finger, device in self.fingers.items()}
        return {name: _facts(device) for name, device in ours.items()}

    def _watch(self, name: str, device: SampledCamera) -> None:
        watch = self._watches.setdefault(name, GarbageWatch(name))
        watch.look(time.monotonic(), device.counts.bad)

    def _picture(self, name: str, camera: SampledCamera | PlainCamera) -> Picture:
        with named("camera", name):
            if isinstance(camera, PlainCamera):
                return camera.picture()
            self._watch(name, camera)
            sample = camera.latest()
            return Picture(sample.raw, sample.index, sample.stamp_ns / NS_PER_S)

    def _touch(self, finger: Finger, device: TactileFinger) -> FingerTouch:
        with named("touch", tactile_name(finger)):
            self._watch(tactile_name(finger), device)
            sample = device.latest()
            image, reference = device.marker_image(sample.raw), self._references[finger]
            is_taxel = isinstance(device, UniforceUskin)
            window = _window(device, self._window) if isinstance(device, UniforceUskin) else None
        raw = sample.raw if is_taxel or self._keep_raw else None
        return FingerTouch(image, reference, sample.index, sample.stamp_ns / NS_PER_S, raw, window)


def _finger(cameras: Mapping[str, Camera], finger: Finger) -> TactileFinger:
    name = tactile_name(finger)
    device = cameras.get(name)
    if not isinstance(device, TactileFinger) or device.config.finger != finger:
        came = "none" if device is None else f"{type(device).__name__} for {getattr(device, 'config', None)}"
        do = f"List it in the robot's cameras, with finger={finger}."
        raise ContractError(expected(name, "a uniforce_tactile or uniforce_uskin camera", came, do))
    return device


def _window(device: UniforceUskin, size: int) -> ScanWindow:
    window = device.upright_window(size)
    first_s = window.stamps_ns[size - window.count] / NS_PER_S
    times_s = np.where(window.stamps_ns == 0, first_s, window.stamps_ns / NS_PER_S)
    return ScanWindow(window.data, times_s)


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
