"""Guided grasps in simulation: two units, an indenter, and the images both fingers would see.

Yields the frames of a rig. The truth beside them judges the score and never enters it. Forces are
canonical (the left finger's frame), so that in equilibrium both are equal.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from uniforce_robots.pairs.guided_grasp import GraspSettings, draw_grasp
from uniforce_robots.pairs.pair_judge import FLOOR_N
from uniforce_robots.pairs.rig import RigFrame
from uniforce_vtla.contact import ContactOptions, gap_maps
from uniforce_vtla.contact.simulator import draw_simulator, images_of
from uniforce_vtla.contracts import FINGERS, ContactState, Finger
from uniforce_vtla.markers.mirror import mirrored

LIMIT = 0.10  # true relative error above which a pair must not be trained on
OPTIONS = ContactOptions()
UNIT_STRENGTH = 1.0  # unit-to-unit variation
MASS_kg = (0.15, 0.40)  # range of the object's mass with what moves of its holder; one per session
MASS_KNOWN = 0.05  # relative standard deviation of the mass an operator enters
# fingers that don't face each other exactly: the right contact lies off by up to so much
MISALIGNED_mm = 0.5
REACH_mm = 4.0  # how far from the pad's centre an object is grasped
CANONICAL = np.array([-1.0, 1.0, 1.0])  # the right finger's own x against the canonical one


@dataclass(frozen=True)
class Rehearsal:
    """One session's rig: registry names, seed of units, grasps and noise, how a hand guides."""

    left_sensor: str = "gelsight"
    right_sensor: str = "tactip"
    seed: int = 0
    grasps: GraspSettings = field(default_factory=GraspSettings)


@dataclass(frozen=True)
class GraspTruth:
    """Truth of a simulated grasp: the pairs' true error (T,), and the faults in it."""

    error: np.ndarray
    fault: str


def equilibrium_error(left_N: np.ndarray, right_N: np.ndarray) -> np.ndarray:
    """Return (T,) ‖F_left − F_right‖ over the mean of both magnitudes, at least ``FLOOR_N``.

    Forces are (T, 3), of each pad in the canonical frame.
    """
    mean = (np.linalg.norm(left_N, axis=-1) + np.linalg.norm(right_N, axis=-1)) / 2
    return np.linalg.norm(left_N - right_N, axis=-1) / np.maximum(mean, FLOOR_N)


class SimulatedRig:
    """A ``PairRig``: two units for a session, and any number of grasps of any indenter."""

    def __init__(self, rehearsal: Rehearsal) -> None:
        self.rehearsal = rehearsal
        self.rate_hz = rehearsal.grasps.rate_hz
        self.sensors: dict[Finger, str] = {
            "left": rehearsal.left_sensor,
            "right": rehearsal.right_sensor,
        }
        self.truths: list[GraspTruth] = []  # of each grasp so far
        self._rng = np.random.default_rng([rehearsal.seed, 77])
        worn = self.sensors.items()
        self._fingers = {
            f: draw_simulator(self._rng, name, UNIT_STRENGTH, OPTIONS) for f, name in worn
        }
        self._true_mass_kg = float(self._rng.uniform(*MASS_kg))
        self.mass_kg = self._true_mass_kg * (1 + MASS_KNOWN * float(self._rng.standard_normal()))

    def references(self) -> dict[Finger, np.ndarray]:
        """Return both free-air marker images (480, 640)."""
        return {finger: simulator.reference() for finger, simulator in self._fingers.items()}

    def frames(self, indenter: str) -> Iterator[RigFrame]:
        """Yield frames of grasps of one indenter without end."""
        while True:
            yield from self._grasp(indenter)

    def _grasp(self, indenter: str) -> list[RigFrame]:
        grasp = draw_grasp(self._rng, self.rehearsal.grasps, self._true_mass_kg, OPTIONS.friction)
        contacts = self._contacts(indenter, grasp.left_N, grasp.right_N)
        images = {f: images_of(self._fingers[f], contact) for f, contact in contacts.items()}
        left_N = self._fingers["left"].carried(contacts["left"])[0]
        right_N = self._fingers["right"].carried(contacts["right"])[0]
        number = len(self.truths)
        self.truths.append(GraspTruth(equilibrium_error(left_N, right_N * CANONICAL), grasp.fault))
        frames = []
        for k, grip_N in enumerate(grasp.grip_N.tolist()):
            pair = {f: images[f][k] for f in FINGERS}
            velocity = grasp.velocity_m_s[k]
            frames.append(RigFrame(number, pair, velocity, grasp.acceleration_m_s2[k], grip_N))
        return frames

    def _contacts(
        self, indenter: str, left_N: np.ndarray, right_N: np.ndarray
    ) -> dict[Finger, ContactState]:
        """Return each finger's contact in its own frame; the place stays the same for a grasp."""
        rng = self._rng
        centre = rng.uniform(-REACH_mm, REACH_mm, 2)
        angle = np.array([rng.uniform(-np.pi, np.pi)])
        scale = np.array([rng.uniform(0.85, 1.15)])
        off = rng.uniform(-1, 1, 2) * MISALIGNED_mm
        left_gap = gap_maps([indenter], centre[None], angle, scale)
        right_gap = gap_maps([indenter], (centre + off)[None], angle, scale)
        return {"left": _held(left_gap, left_N), "right": mirrored(_held(right_gap, right_N))}


def _held(gap: np.ndarray, load: np.ndarray) -> ContactState:
    """Return an object (1, G, G) in each frame of a load (T, 3), none where the load is none."""
    gaps = np.repeat(gap, len(load), axis=0)
    gaps[load[:, 2] <= 0] = np.inf
    return ContactState(
        gaps.astype(np.float32), load.astype(np.float32), np.zeros(len(load), np.float32)
    )
