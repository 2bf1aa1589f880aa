"""The sensor on a simulated finger: one unit as a lab would find it, or the bare drawing."""

import zlib
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from uniforce_vtla.contact.indenters import flat_face_gap
from uniforce_vtla.contact.raw_look import PixelNoise
from uniforce_vtla.contact.responses import ContactOptions
from uniforce_vtla.contact.simulator import TactileSimulator, free_air
from uniforce_vtla.contact.units import Look, UnitVariation
from uniforce_vtla.contact.virtual import VirtualSensor, get_material
from uniforce_vtla.contact.wear import Creep, Light
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.errors import SensorError
from uniforce_vtla.markers.canonicalizer import Canonicalizer

CREEP_SHARE = (0.05, 0.20)  # part of a motion that comes late; rubbers .1–.3
WARN_SHARE = 0.12  # of the markers lost: a healthy unit in the firmest grasps loses up to a tenth
MARKER_LOSS = 0.02  # chance per marker and frame that the camera misses it; ViTac 2024 draws .01
LAG_STEPS = 1  # 33 ms from exposure to image
# it is the median of, as on a robot: a stream's reference shows what one frame misses
REFERENCE_FRAMES = 10
STALE_SIDE_mm = 15.0
STALL_EVERY = 60  # control steps, 2 s


@dataclass(frozen=True)
class WornSensor:
    """One unit of a sensor on a finger.

    Cameras show raw frames, which the canonicalizer turns into marker images as on a robot; it may refuse one. The
    drawn stiffness decides the picture and the pad in MuJoCo.
    """

    sensor: VirtualSensor  # its drawing and material
    # how this one differs from the drawing
    unit: UnitVariation = field(default_factory=UnitVariation)
    light: Light | None = None  # on its camera
    creep: Creep | None = None  # of its rubber
    marker_loss: float = 0.0  # chance per marker and frame
    lag_steps: int = 0  # control steps by which its picture is late
    # the unit as it is now, if it changed after its reference was taken
    since: UnitVariation | None = None
    light_since: Light | None = None  # the light as it is now, if it changed since the reference
    stale_N: float = 0.0  # pressed on the pad while the reference was taken
    # control steps out of every STALL_EVERY for which the picture stands still
    stall_steps: int = 0
    direct: bool = False  # True: the fast path, no raw frame

    @property
    def kind(self) -> str:
        """Registry name of the sensor whose body it has: decides the pad in the simulator and what a policy knows."""
        return self.sensor.like

    @property
    def stiffness(self) -> float:
        """Stiffness over the nominal one of its kind."""
        return (
            self.unit.stiffness * self.sensor.material.stiffness / get_material(self.kind).stiffness
        )


class WornView:
    """Images of one unit's contacts: contact model, raw frame under its light, canonicalizer.

    Creep and lag depend on time: the caller, which follows the contact, applies them.

    Args:
        worn: the unit; ``direct`` leaves raw frame and canonicalizer out.
        seed: draws the noise.
        pixel_noise: of raw frames, see ``ContactOptions``.
        register: see ``Canonicalizer``.
        stream: images follow one another, see ``Canonicalizer``, and the reference is taken as on a robot.

    Raises SensorError: the canonicalizer refuses the reference.
    """

    def __init__(
        self,
        worn: WornSensor,
        seed: int = 0,
        pixel_noise: PixelNoise = "sheet",
        register: bool = True,
        stream: bool = False,
    ) -> None:
        options = ContactOptions(
            marker_loss=worn.marker_loss > 0,
            loss_probability=worn.marker_loss,
            pixel_noise=pixel_noise,
        )
        self.worn, self.simulator = worn, TactileSimulator(worn.sensor, worn.unit, options, seed)
        self._canonicalizer = Canonicalizer(
            worn.kind, register=register, warn_share=WARN_SHARE, stream=stream
        )
        self._light = worn.light
        if worn.direct:
            stale = worn.stale_N > 0
            shown = (
                self.simulator.marker_images(_left_on(worn.stale_N))[0]
                if stale
                else self.simulator.reference()
            )
            self.reference = shown  # (480, 640) uint8
        else:
            left_on = _left_on(worn.stale_N, REFERENCE_FRAMES if stream else 1)
            seen = self._lit(self.simulator.raw_frames(left_on))
            raw = np.median(seen, axis=0).astype(seen.dtype)
            self._canonicalizer.set_reference(raw)
            self.reference = self._canonicalizer.marker_image(raw)
        self._light = worn.light_since or worn.light
        if worn.since is not None:
            self.simulator = TactileSimulator(worn.sensor, worn.since, options, seed)

    def images(self, contact: ContactState) -> np.ndarray:
        """Return (B, 480, 640) uint8 marker images in the sensor's own frame.

        Raises SensorError: the canonicalizer refuses a frame.
        """
        if self.worn.direct:
            return self.simulator.marker_images(contact)
        frames = self._lit(self.simulator.raw_frames(contact))
        return np.stack([self._canonicalizer.marker_image(frame) for frame in frames])

    def accepted(self, contact: ContactState) -> dict[int, np.ndarray]:
        """Return row → its marker image, as ``images``; frames that the canonicalizer refuses are left out."""
        if self.worn.direct:
            return dict(enumerate(self.images(contact)))
        found = {}
        for row, frame in enumerate(self._lit(self.simulator.raw_frames(contact))):
            with suppress(SensorError):
                found[row] = self._canonicalizer.marker_image(frame)
        return found

    def _lit(self, raw: np.ndarray) -> np.ndarray:
        return raw if self._light is None else self._light.on(raw)


def _left_on(press_N: float, frames: int = 1) -> ContactState:
    """Return what is on a pad while its reference is taken: nothing, or a small flat thing that presses on it."""
    if not press_N:
        return free_air(frames)
    flat = (
        np.zeros((frames, 2)),
        np.full((frames, 2), STALE_SIDE_mm),
        np.zeros(frames),
        np.zeros((frames, 2)),
    )
    force_N = np.tile(np.array([0, 0, press_N], np.float32), (frames, 1))
    return ContactState(flat_face_gap(*flat), force_N, np.zeros(frames, np.float32))


def drawing(sensor: VirtualSensor) -> WornSensor:
    """Return the sensor as it is drawn, by the fast path."""
    return WornSensor(sensor, direct=True)


def unit_of(sensor: VirtualSensor, number: int) -> WornSensor:
    """Return a unit by its number: moulding, camera pose, light and rubber are drawn from it."""
    rng = np.random.default_rng([number, zlib.crc32(sensor.name.encode())])
    unit, creep = UnitVariation.draw(rng, sensor), Creep.draw(rng, CREEP_SHARE)
    if sensor.spec.signal != "camera":
        return WornSensor(sensor, unit, None, creep, lag_steps=LAG_STEPS)
    return WornSensor(
        sensor, unit.mounted(rng, Look()), Light.draw(rng), creep, MARKER_LOSS, LAG_STEPS
    )
