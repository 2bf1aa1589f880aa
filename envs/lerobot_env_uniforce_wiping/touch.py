"""Contact truth of a pad → its marker image: contact model, raw frame, canonicalizer."""

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from lerobot_env_uniforce_wiping.mjcf import FELT_m
from lerobot_env_uniforce_wiping.simulation import WipeSimulation
from uniforce_vtla.contact import free_air
from uniforce_vtla.contact.indenters import flat_face_gap
from uniforce_vtla.contact.worn import STALL_EVERY, WornSensor, WornView
from uniforce_vtla.contracts import ContactState, Finger
from uniforce_vtla.errors import SensorError

TOUCHING_N = 0.02  # below this the pad counts as in free air


@dataclass(frozen=True)
class Load:
    """Load of a pad at one step: canonical wrench (4,), and the block's pose in the tool frame."""

    wrench: np.ndarray
    center_m: np.ndarray
    axes: np.ndarray


class PadImages:
    """One finger's sensor in the scene; images in its own frame, never flipped.

    Call ``follow`` at every control step, since rubber and cameras are late; ``image`` draws.

    Args:
        sensor: sensor mounted on the finger.
        finger: which finger it is.
        seed: draws the sensor's noise; the same episode shows the same images.

    Raises:
        SensorError: the canonicalizer refuses the reference.
    """

    def __init__(self, sensor: WornSensor, finger: Finger, seed: int) -> None:
        self.finger = finger
        self._worn = sensor
        with self._named():
            self._view = WornView(sensor, seed=2 * seed + (finger == "right"), stream=True)
        self._past: deque[Load] = deque(maxlen=sensor.lag_steps + 1)
        self._late = np.zeros(4)
        self._steps = 0
        self._shown: np.ndarray | None = None  # the latest image
        self.reference = self._view.reference  # (480, 640) uint8

    def follow(self, sim: WipeSimulation) -> None:
        """Look at the pad after a control step."""
        self._steps += 1
        wrench = sim.pads[self.finger].wrench.astype(np.float64)
        if creep := self._worn.creep:
            self._late += (1 - np.exp(-1 / (creep.relaxation_s * CONTROL_HZ))) * (
                wrench - self._late
            )
            wrench = (1 - creep.share) * wrench + creep.share * self._late
        self._past.append(Load(wrench, *sim.block_from_pad(self.finger)))

    def image(self, sim: WipeSimulation) -> np.ndarray:
        """Return the marker image, (480, 640) uint8; a stalled camera shows the same array again.

        Raises:
            SensorError: the canonicalizer refuses the frame.
        """
        if self._shown is not None and self._steps % STALL_EVERY < self._worn.stall_steps:
            return self._shown
        contact = pad_contact(self._past[0], sim, self.finger)
        # forces are the step's mean: the eraser left within it
        if not self._view.simulator.faces_object(contact)[0]:
            contact = free_air(1)
        with self._named():
            self._shown = self._view.images(contact)[0]
        return self._shown

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Say which sensor it was that gave no picture."""
        try:
            yield
        except SensorError as error:
            raise SensorError(f"{self._worn.kind} on the {self.finger} finger: {error}") from error


def pad_contact(load: Load, sim: WipeSimulation, finger: Finger) -> ContactState:
    """Return the contact of a pad in that finger's own image frame, batch of one."""
    mirror = 1.0 if finger == "left" else -1.0  # the right finger's image x is world −y
    fx, fy, fz, torsion = load.wrench
    if fz < TOUCHING_N:
        return free_air(1)
    force = np.array([[mirror * fx, fy, fz]], dtype=np.float32)
    torsion_Nmm = np.array([mirror * torsion], dtype=np.float32)
    return ContactState(eraser_gap(load, sim, finger), force, torsion_Nmm)


def eraser_gap(load: Load, sim: WipeSimulation, finger: Finger) -> np.ndarray:
    """Return (1, G, G) gap of the eraser's side face as this pad sees it."""
    mirror = 1.0 if finger == "left" else -1.0
    layout = sim.scene.level.layout
    center = load.center_m
    axes = load.axes
    size = np.array([[sim.scene.eraser_length_m, layout.eraser_height_m - FELT_m]]) * 1000
    along = axes[:, 1]  # the eraser's long axis
    across = axes[:, 0]  # the normal of its side faces
    angle = np.arctan2(-mirror * along[2], along[1])
    tilt = np.array([[across[1], -mirror * across[2]]]) / across[0]
    middle = np.array([[-mirror * center[1], center[2]]]) * 1000
    return flat_face_gap(middle, size, np.array([angle]), np.arctan(tilt))
