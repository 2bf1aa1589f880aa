"""Rig that the recording loop drives, robot and scene alike, and its readings at one tick.

All times of a rig are seconds on one clock: the host's monotonic one, or the scene's own.
"""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from uniforce_robots.sensors.plain_camera import Picture
from uniforce_vtla.contracts import Finger
from uniforce_vtla.evaluation.episode import EpisodeResult

Shape = tuple[int, int, int]


@dataclass(frozen=True)
class FingerTouch(Picture):
    """One finger's newest sample; ``image`` is (480, 640) uint8, the sensor's own marker image."""

    reference: np.ndarray  # the same in free air; one array for the whole episode
    # (H, W, 3) uint8 frame or (16, 3) counts, upright; None: no raw signal
    raw: np.ndarray | None = None
    # of taxels only: the newest scans (size, 16, 3), oldest first and repeated if there are fewer
    window: np.ndarray | None = None
    window_times_s: np.ndarray | None = None  # (size,) when each was taken


@dataclass(frozen=True)
class Observation:
    """One tick."""

    time_s: float  # when it was taken
    axes: np.ndarray  # (5,) measured x, y, z, yaw, width as in ``keys.AXES``
    cameras: dict[str, Picture]
    fingers: dict[Finger, FingerTouch]
    # columns, as ``RigFacts.measured`` says
    measured: dict[str, np.ndarray] = field(default_factory=dict)
    # (3,) on the hand since the references were taken, base frame; on a robot an estimate
    force_N: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def samples(self) -> dict[str, Picture]:
        """Pictures by camera and finger."""
        return {**self.cameras, **{str(finger): touch for finger, touch in self.fingers.items()}}


@dataclass(frozen=True)
class RigFacts:
    """Streams of a rig; known before it is connected."""

    name: str  # e.g. ``uniforce_franka`` or ``sim``
    fps: int  # ticks per second
    sensors: dict[Finger, str]  # registry name by finger
    cameras: dict[str, Shape]  # (rows, columns, 3) by scene camera
    # raw camera frames to be kept; no taxels
    raw_frames: dict[Finger, Shape] = field(default_factory=dict)
    windows: dict[Finger, int] = field(default_factory=dict)  # taxel scans kept per tick, by finger
    # LeRobot feature of each further column
    measured: dict[str, dict[str, Any]] = field(default_factory=dict)
    # whether ticks keep to the wall clock; False runs as fast as the scene steps
    paced: bool = True
    # whether it is the scene: ``measured`` holds the true wrenches; it steps in episodes only
    simulated: bool = False


class Rig(Protocol):
    """A robot with its sensors, or the scene. Methods but ``hold`` may raise a UniForceError."""

    facts: RigFacts  # what it delivers
    prompt: str | None = None  # the instruction a scene comes with; None where a person gives it
    is_done: bool = False  # whether the task itself has ended; a robot never knows

    def now_s(self) -> float:
        """Return the time on the clock of all its stamps."""

    def connect(self) -> None:
        """Open everything. Nothing moves."""

    def close(self) -> None:
        """Stop, hang up, join every thread. Safe to call twice."""

    def axes(self) -> np.ndarray:
        """Return (5,) where it is now; works before the first reference."""

    def begin_episode(self, seed: int) -> None:
        """Take the free-air references, or build the scene of ``seed``; raises: sensors unwell."""

    def observe(self) -> Observation:
        """Return the newest of everything; DeviceError: a sensor is lost, stale, frozen or bad."""

    def act(self, action: np.ndarray) -> np.ndarray:
        """Go to (5,) absolute targets; return what was sent after the guards."""

    def hold(self) -> None:
        """Rest where it is, at once; never raises. A scene that isn't stepped rests."""
        return

    def recover(self) -> None:
        """Clear a fault on a person's word; nothing moves. A scene has none."""
        return

    def verdict(self) -> EpisodeResult | None:
        """Return how the episode went, where the rig knows better than a person."""
        return None

    def stored_facts(self) -> dict[str, Any]:
        """Return a connected robot's lasting settings, as JSON values; a scene has none."""
        return {}

    def summary(self) -> dict[str, Any]:
        """Return facts for a card: guards that acted, samples lost, settings read back."""
