"""Contact truth of a pad → its marker image, through the one contact model."""

import cv2
import numpy as np

from lerobot_env_uniforce_wiping.mjcf import FELT_m
from lerobot_env_uniforce_wiping.simulation import WipeSimulation
from lerobot_env_uniforce_wiping.worn import WornSensor
from uniforce_vtla.contact import TactileSimulator, free_air
from uniforce_vtla.contact.indenters import flat_face_gap
from uniforce_vtla.contracts import ContactState, Finger

TOUCHING_N = 0.02  # below this the pad counts as in free air


class PadImages:
    """What one finger's sensor shows in the scene, in its own frame, never flipped.

    Args:
        sensor: what the finger wears.
        finger: which finger it is.
        seed: draws the sensor's noise; the same episode shows the same images.
    """

    def __init__(self, sensor: WornSensor, finger: Finger, seed: int) -> None:
        self.finger = finger
        self._sensor = TactileSimulator(sensor.sensor, sensor.unit, seed=2 * seed + (finger == "right"))
        self._free = self._sensor.reference()
        self.reference = cv2.cvtColor(self._free, cv2.COLOR_GRAY2RGB)

    def image(self, sim: WipeSimulation) -> np.ndarray:
        """Return (480, 640, 3) uint8: the marker image, repeated on three channels."""
        contact = own_contact(sim, self.finger)
        if not self._sensor.faces_object(contact)[0]:  # forces are the step's mean: the eraser left within it
            contact = free_air(1)
        return cv2.cvtColor(self._sensor.marker_images(contact)[0], cv2.COLOR_GRAY2RGB)


def own_contact(sim: WipeSimulation, finger: Finger) -> ContactState:
    """Return the contact of a pad in that finger's own image frame, batch of one."""
    mirror = 1.0 if finger == "left" else -1.0  # the right finger's image x is world −y
    fx, fy, fz, torsion = sim.pads[finger].wrench
    if fz < TOUCHING_N:
        return free_air(1)
    force = np.array([[mirror * fx, fy, fz]], dtype=np.float32)
    return ContactState(eraser_gap(sim, finger), force, np.array([mirror * torsion], dtype=np.float32))


def eraser_gap(sim: WipeSimulation, finger: Finger) -> np.ndarray:
    """Return (1, G, G) gap of the eraser's side face as this pad sees it."""
    mirror = 1.0 if finger == "left" else -1.0
    layout = sim.scene.level.layout
    center, axes = sim.block_from_pad(finger)  # tool frame: x closes, y = world −y, z down
    size = np.array([[sim.scene.eraser_length_m, layout.eraser_height_m - FELT_m]]) * 1000
    along, across = axes[:, 1], axes[:, 0]  # the eraser's long axis; the normal of its side faces
    angle = np.arctan2(-mirror * along[2], along[1])
    tilt = np.array([[across[1], -mirror * across[2]]]) / across[0]
    middle = np.array([[-mirror * center[1], center[2]]]) * 1000
    return flat_face_gap(middle, size, np.array([angle]), np.arctan(tilt))
