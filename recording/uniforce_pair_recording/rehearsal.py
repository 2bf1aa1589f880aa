"""Guided grasps in simulation: two units, an indenter, and the images both fingers would see.

Yields what a rig would deliver, and beside it the truth, which only the evaluation may read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from uniforce_pair_recording.guided_grasp import GraspSettings, RobotReadings, draw_grasp
from uniforce_pair_recording.truth import equilibrium_error
from uniforce_vtla.contact.indenters import gap_maps
from uniforce_vtla.contact.mirror import mirrored
from uniforce_vtla.contact.options import ContactOptions
from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.contact.views import draw_simulator, images_of
from uniforce_vtla.contracts import ContactState, Finger

REACH_mm = 4.0  # how far from the pad's centre an object is grasped
CANONICAL = np.array([-1.0, 1.0, 1.0])  # the right finger's own x against the canonical one


@dataclass(frozen=True)
class Rehearsal:
    """One session's rig.

    Attributes:
        left_sensor, right_sensor: registry names.
        seed: of units, grasps and noise.
        unit_strength: unit-to-unit variation.
        misaligned_mm: fingers that don't face each other exactly: the right contact lies off by up to so much.
        grasps: how a hand guides.
        options: terms of the contact model.
    """

    left_sensor: str = "gelsight"
    right_sensor: str = "tactip"
    seed: int = 0
    unit_strength: float = 1.0
    misaligned_mm: float = 0.5
    grasps: GraspSettings = field(default_factory=GraspSettings)
    options: ContactOptions = field(default_factory=ContactOptions)


@dataclass(frozen=True)
class GraspFrames:
    """What a rig delivers of one grasp, T frames; images as each sensor saw them.

    Attributes:
        indenter: what is held.
        left, right: (T, 480, 640) uint8 marker images.
        readings: the robot's own measurements.
    """

    indenter: str
    left: np.ndarray
    right: np.ndarray
    readings: RobotReadings


@dataclass(frozen=True)
class GraspTruth:
    """What only a simulator knows: forces (T, 3) canonical, their error (T,), and what went wrong."""

    left_N: np.ndarray
    right_N: np.ndarray
    error: np.ndarray
    fault: str


class SimulatedRig:
    """Two units that live for a session, and as many grasps of any indenter as one asks for."""

    def __init__(self, rehearsal: Rehearsal) -> None:
        self.rehearsal = rehearsal
        self._rng = np.random.default_rng([rehearsal.seed, 77])
        self._fingers: dict[Finger, TactileSimulator] = {
            "left": self._draw(rehearsal.left_sensor),
            "right": self._draw(rehearsal.right_sensor),
        }

    def _draw(self, sensor: str) -> TactileSimulator:
        return draw_simulator(self._rng, sensor, self.rehearsal.unit_strength, self.rehearsal.options)

    def reference(self, finger: Finger) -> np.ndarray:
        """(480, 640) marker image in free air."""
        return self._fingers[finger].reference()

    def grasps(self, indenter: str) -> Iterator[tuple[GraspFrames, GraspTruth]]:
        """Yield grasps of one indenter without end."""
        while True:
            yield self._grasp(indenter)

    def _grasp(self, indenter: str) -> tuple[GraspFrames, GraspTruth]:
        grasp = draw_grasp(self._rng, self.rehearsal.grasps, self.rehearsal.options.friction)
        left, right = self._contacts(indenter, grasp.left_N, grasp.right_N)
        images = [
            images_of(self._fingers[finger], contact)
            for finger, contact in (("left", left), ("right", right))  # type: ignore[index]
        ]
        carried = [self._fingers["left"].carried(left)[0], self._fingers["right"].carried(right)[0] * CANONICAL]
        truth = GraspTruth(*carried, equilibrium_error(*carried), grasp.fault)
        return GraspFrames(indenter, images[0], images[1], grasp.readings), truth

    def _contacts(
        self, indenter: str, left_N: np.ndarray, right_N: np.ndarray
    ) -> tuple[ContactState, ContactState]:
        """Return what either finger feels, each in its own frame; the place stays the same for a grasp."""
        T, rng = len(left_N), self._rng
        centre = rng.uniform(-REACH_mm, REACH_mm, 2)
        angle, scale = rng.uniform(-np.pi, np.pi), rng.uniform(0.85, 1.15)
        off = rng.uniform(-1, 1, 2) * self.rehearsal.misaligned_mm
        gaps = [gap_maps([indenter], at[None], np.array([angle]), np.array([scale])) for at in (centre, centre + off)]
        states = [
            ContactState(_repeated(gap, load), load.astype(np.float32), np.zeros(T, np.float32))
            for gap, load in zip(gaps, (left_N, right_N), strict=True)
        ]
        return states[0], mirrored(states[1])


def _repeated(gap: np.ndarray, load: np.ndarray) -> np.ndarray:
    """(T, G, G): the same object in each frame, nothing where the pad carries nothing."""
    gaps = np.repeat(gap, len(load), axis=0)
    gaps[load[:, 2] <= 0] = np.inf
    return gaps.astype(np.float32)
