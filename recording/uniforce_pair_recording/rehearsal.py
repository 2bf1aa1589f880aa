"""Guided grasps in simulation: two units, an indenter, and the images both fingers would see.

Yields what a rig would deliver, and beside it the truth, which only the evaluation may read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from uniforce_pair_recording.guided_grasp import GraspSettings, draw_grasp
from uniforce_pair_recording.rig import RigFrame
from uniforce_pair_recording.truth import equilibrium_error
from uniforce_vtla.contact.indenters import gap_maps
from uniforce_vtla.contact.mirror import mirrored
from uniforce_vtla.contact.options import ContactOptions
from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.contact.views import draw_simulator, images_of
from uniforce_vtla.contracts import FINGERS, ContactState, Finger

REACH_mm = 4.0  # how far from the pad's centre an object is grasped
CANONICAL = np.array([-1.0, 1.0, 1.0])  # the right finger's own x against the canonical one


@dataclass(frozen=True)
class Rehearsal:
    """One session's rig.

    Attributes:
        left_sensor, right_sensor: registry names.
        seed: of units, grasps and noise.
        unit_strength: unit-to-unit variation.
        mass_kg: range of the object's mass with what moves of its holder; one per session.
        mass_known: relative standard deviation of the mass an operator enters.
        misaligned_mm: fingers that don't face each other exactly: the right contact lies off by up to so much.
        grasps: how a hand guides.
        options: terms of the contact model.
    """

    left_sensor: str = "gelsight"
    right_sensor: str = "tactip"
    seed: int = 0
    unit_strength: float = 1.0
    mass_kg: tuple[float, float] = (0.15, 0.40)
    mass_known: float = 0.05
    misaligned_mm: float = 0.5
    grasps: GraspSettings = field(default_factory=GraspSettings)
    options: ContactOptions = field(default_factory=ContactOptions)


@dataclass(frozen=True)
class GraspTruth:
    """What only a simulator knows: forces (T, 3) canonical, their error (T,), and what went wrong."""

    left_N: np.ndarray
    right_N: np.ndarray
    error: np.ndarray
    fault: str


class SimulatedRig:
    """A ``PairRig``: two units that live for a session, and as many grasps of any indenter as one asks for."""

    def __init__(self, rehearsal: Rehearsal) -> None:
        self.rehearsal = rehearsal
        self.rate_hz = rehearsal.grasps.rate_hz
        self.sensors: dict[Finger, str] = {"left": rehearsal.left_sensor, "right": rehearsal.right_sensor}
        self._rng = np.random.default_rng([rehearsal.seed, 77])
        self._fingers = {f: self._draw(sensor) for f, sensor in self.sensors.items()}
        self._true_mass_kg = float(self._rng.uniform(*rehearsal.mass_kg))
        self.mass_kg = self._true_mass_kg * (1 + rehearsal.mass_known * float(self._rng.standard_normal()))
        self._truths: list[GraspTruth] = []

    def references(self) -> dict[Finger, np.ndarray]:
        """Return both free-air marker images (480, 640)."""
        return {finger: simulator.reference() for finger, simulator in self._fingers.items()}

    def frames(self, indenter: str) -> Iterator[RigFrame]:
        """Yield frames of grasps of one indenter without end."""
        while True:
            yield from self._grasp(indenter)

    def truth_of(self, grasp: int) -> GraspTruth:
        """Return the truth of a grasp by its number: for whoever judges the score, never for the score."""
        return self._truths[grasp]

    def _draw(self, sensor: str) -> TactileSimulator:
        return draw_simulator(self._rng, sensor, self.rehearsal.unit_strength, self.rehearsal.options)

    def _grasp(self, indenter: str) -> list[RigFrame]:
        settings, friction = self.rehearsal.grasps, self.rehearsal.options.friction
        grasp = draw_grasp(self._rng, settings, self._true_mass_kg, friction)
        contacts = dict(zip(FINGERS, self._contacts(indenter, grasp.left_N, grasp.right_N), strict=True))
        images = {f: images_of(self._fingers[f], contact) for f, contact in contacts.items()}
        left, right = (self._fingers[f].carried(contact)[0] for f, contact in contacts.items())
        error = equilibrium_error(left, right * CANONICAL)
        self._truths.append(GraspTruth(left, right * CANONICAL, error, grasp.fault))
        number, r = len(self._truths) - 1, grasp.readings
        return [
            RigFrame(
                number,
                {f: images[f][k] for f in FINGERS},
                r.velocity_m_s[k],
                r.acceleration_m_s2[k],
                float(r.grip_N[k]),
            )
            for k in range(len(left))
        ]

    def _contacts(
        self, indenter: str, left_N: np.ndarray, right_N: np.ndarray
    ) -> tuple[ContactState, ContactState]:
        """Return what either finger feels, each in its own frame; the place stays the same for a grasp."""
        T, rng = len(left_N), self._rng
        centre = rng.uniform(-REACH_mm, REACH_mm, 2)
        angle, scale = rng.uniform(-np.pi, np.pi), rng.uniform(0.85, 1.15)
        off = rng.uniform(-1, 1, 2) * self.rehearsal.misaligned_mm
        gaps = [
            gap_maps([indenter], at[None], np.array([angle]), np.array([scale]))
            for at in (centre, centre + off)
        ]
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
