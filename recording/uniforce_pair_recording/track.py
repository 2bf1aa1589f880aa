"""A grasp as it grows: each frame's fields and forces are read once, its pairs can be judged at any time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from uniforce_pair_recording.finger_force import FingerForce
from uniforce_pair_recording.pair_judge import GraspSignals
from uniforce_pair_recording.rig import RigFrame
from uniforce_pair_recording.touch_field import TouchField
from uniforce_vtla.contracts import FINGERS, Finger


class FingerReader:
    """One finger of a session: marker image → touch field and force."""

    def __init__(self, reference: np.ndarray, finger: Finger, force: FingerForce) -> None:
        self._field, self._force = TouchField(reference, finger), force

    def __call__(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (192,) field and (3,) N, canonical frame."""
        field_ = self._field(image)
        return field_, self._force.read(field_[None])[0]


@dataclass
class GraspTrack:
    """Frames of one grasp with what was read off them; images stay, since the good ones are kept."""

    mass_kg: float
    frames: list[RigFrame] = field(default_factory=list)
    fields: dict[Finger, list[np.ndarray]] = field(default_factory=lambda: {f: [] for f in FINGERS})
    forces: dict[Finger, list[np.ndarray]] = field(default_factory=lambda: {f: [] for f in FINGERS})

    def add(self, frame: RigFrame, readers: dict[Finger, FingerReader]) -> None:
        """Read a frame and keep it."""
        self.frames.append(frame)
        for finger, read in readers.items():
            field_, force = read(frame.images[finger])
            self.fields[finger].append(field_)
            self.forces[finger].append(force)

    def signals(self) -> GraspSignals:
        """Return what the judge wants to know."""
        return GraspSignals(
            np.array(self.forces["left"]),
            np.array(self.forces["right"]),
            np.array([frame.velocity_m_s for frame in self.frames]),
            np.array([frame.acceleration_m_s2 for frame in self.frames]),
            self.mass_kg,
        )
