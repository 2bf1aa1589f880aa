"""What the loop needs of whatever is recorded; a robot and the simulated scene look alike from here."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from uniforce_recording.observation import Observation
from uniforce_vtla.contracts import Finger

Shape = tuple[int, int, int]


@dataclass(frozen=True)
class Verdict:
    """How an episode went: ``outcome`` as in ``keys.OUTCOME_NAMES``, and whether it was a clean success."""

    outcome: str
    clean: bool


@dataclass(frozen=True)
class RigFacts:
    """What a rig delivers; known before it is connected.

    Attributes:
        name: e.g. ``uniforce_franka`` or ``sim``.
        fps: ticks per second.
        sensors: registry name by finger.
        cameras: (rows, columns, 3) by scene camera.
        raw_frames: (rows, columns, 3) of raw camera frames by finger, those to be kept; taxels aren't in here.
        windows: taxel scans kept per tick, by finger.
        measured: LeRobot feature of each further column, by key.
        truth: whether ``measured`` holds the true pad wrenches.
        paced: whether ticks keep to the wall clock; False runs as fast as the scene steps.
    """

    name: str
    fps: int
    sensors: dict[Finger, str]
    cameras: dict[str, Shape]
    raw_frames: dict[Finger, Shape] = field(default_factory=dict)
    windows: dict[Finger, int] = field(default_factory=dict)
    measured: dict[str, dict[str, Any]] = field(default_factory=dict)
    truth: bool = False
    paced: bool = True


class Rig(Protocol):
    """A robot with its sensors, or the scene. Every method may raise a UniForceError."""

    @property
    def facts(self) -> RigFacts:
        """What it delivers."""

    @property
    def is_done(self) -> bool:
        """Whether the task itself has ended; a robot never knows."""

    @property
    def can_drive_between(self) -> bool:
        """Whether ``act`` may be called between episodes; a scene only steps inside one."""

    @property
    def prompt(self) -> str | None:
        """The instruction a scene comes with; None where a person gives it."""

    def now_s(self) -> float:
        """Return the time on the clock of all its stamps."""

    def connect(self) -> None:
        """Open everything. Nothing moves."""

    def close(self) -> None:
        """Stop, hang up, join every thread. Safe to call twice."""

    def axes(self) -> np.ndarray:
        """(5,) where it is now; works before the first reference."""

    def begin_episode(self, seed: int) -> None:
        """Take the free-air references, or build the scene of ``seed``.

        Raises:
            SensorError: no free air, or a sensor that isn't well.
        """

    def observe(self) -> Observation:
        """Return the newest of everything.

        Raises:
            DeviceError: a camera or finger that is lost, stale, frozen or bad.
            RobotError: a fault of the arm or the hand.
        """

    def act(self, action: np.ndarray) -> np.ndarray:
        """Go to (5,) absolute targets; return what was sent after the guards."""

    def hold(self) -> None:
        """Rest where it is, at once; never raises."""

    def recover(self) -> None:
        """Clear a fault on a person's word; nothing moves."""

    def verdict(self) -> Verdict | None:
        """Return how the episode went, where the rig knows better than a person."""

    def summary(self) -> dict[str, Any]:
        """Return what a card shall tell of the rig: guards that acted, samples lost, settings read back."""
