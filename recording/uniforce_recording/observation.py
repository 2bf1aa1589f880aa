"""What a rig tells at one tick: the five axes, the newest of each camera and finger with its time, and more.

All times of one rig are seconds on one clock: the host's monotonic one on a robot, the scene's own in simulation.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from uniforce_vtla.contracts import Finger


@dataclass(frozen=True)
class Picture:
    """A scene camera's newest frame: (H, W, 3) uint8 RGB, its number since connecting, when it was taken."""

    image: np.ndarray
    index: int
    time_s: float


@dataclass(frozen=True)
class ScanWindow:
    """The newest taxel scans, oldest first.

    Attributes:
        scans: (size, 16, 3) counts, upright; the oldest repeats where there were fewer.
        times_s: (size,) when each was taken.
    """

    scans: np.ndarray
    times_s: np.ndarray


@dataclass(frozen=True)
class FingerTouch:
    """What a finger feels.

    Attributes:
        image: (480, 640) uint8 marker image, as the sensor sees it.
        reference: the same in free air; one array for the whole episode.
        index: number of the sample since connecting.
        time_s: when it was taken.
        raw: (H, W, 3) uint8 camera frame or (16, 3) counts, upright; None where a rig has no raw signal.
        window: of taxels only.
    """

    image: np.ndarray
    reference: np.ndarray
    index: int
    time_s: float
    raw: np.ndarray | None = None
    window: ScanWindow | None = None


@dataclass(frozen=True)
class Observation:
    """One tick.

    Attributes:
        time_s: when it was taken.
        axes: (5,) measured x, y, z, yaw, width as in ``keys.AXES``.
        cameras: by name.
        fingers: both.
        measured: further columns by key, dtype and shape as ``RigFacts.measured`` announces.
        force_N: (3,) force of the world on the hand since the references were taken, base frame; on a robot an
            estimate.
    """

    time_s: float
    axes: np.ndarray
    cameras: dict[str, Picture]
    fingers: dict[Finger, FingerTouch]
    measured: dict[str, np.ndarray] = field(default_factory=dict)
    force_N: np.ndarray = field(default_factory=lambda: np.zeros(3))
