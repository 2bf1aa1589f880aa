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

    Cameras show raw frames, which the canonicalizer turns into marker images or refuses, as on a
    robot. The drawn stiffness decides the picture and the pad in MuJoCo.
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
        """Registry name of the sensor whose body it has: what MuJoCo has and a policy knows."""
        return self.sensor.like

    @property
    def stiffness(self) -> float:
        """Stiffness over the nominal one of its kind."""
        nominal = get_material(self.kind).stiffness
        return self.unit.stiffness * self.sensor.material.stiffness / nominal


class WornView:
    """Images of one unit's contacts: contact model, raw frame under its light, canonicalizer.

    Creep and lag depend on time: the caller, which follows the contact, applies them.

    Args:
        worn: the unit; ``direct`` leaves raw frame and canonicalizer out.
        seed: draws the noise.
        pixel_noise: of raw frames, see ``ContactOptions``.
        register: see ``Canonicalizer``.
        stream: images follow one another, see ``Canonicalizer``; the reference is a median.

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
        self.worn = worn
        self.simulator = TactileSimulator(worn.sensor, worn.unit, options, seed)
        self._canonicalizer = Canonicalizer(
            worn.kind, register=register, warn_share=WARN_SHARE, stream=stream
        )
        self._light = worn.light
        frames = 1
        if stream and not worn.direct:
            frames = REFERENCE_FRAMES
        left_on = _left_on(worn.stale_N, frames)
        self.reference: np.ndarray  # (480, 640) uint8
        if worn.direct and worn.stale_N > 0:
            self.reference = self.simulator.marker_images(left_on)[0]
        elif worn.direct:
            self.reference = self.simulator.reference()
        else:
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
        """Return row → its marker image, without the frames that the canonicalizer refuses."""
        if self.worn.direct:
            return dict(enumerate(self.images(contact)))
        found = {}
        for row, frame in enumerate(self._lit(self.simulator.raw_frames(contact))):
            with suppress(SensorError):
                found[row] = self._canonicalizer.marker_image(frame)
        return found

    def _lit(self, raw: np.ndarray) -> np.ndarray:
        if self._light is None:
            return raw
        return self._light.on(raw)


def _left_on(press_N: float, frames: int = 1) -> ContactState:
    """Return the contact while a reference is taken: none, or a small flat thing that presses."""
    if not press_N:
        return free_air(frames)
    nothing = np.zeros((frames, 2))
    sides_mm = np.full((frames, 2), STALE_SIDE_mm)
    gap_mm = flat_face_gap(nothing, sides_mm, np.zeros(frames), nothing)
    force_N = np.tile(np.array([0, 0, press_N], np.float32), (frames, 1))
    return ContactState(gap_mm, force_N, np.zeros(frames, np.float32))


def drawing(sensor: VirtualSensor) -> WornSensor:
    """Return the sensor as it is drawn, by the fast path."""
    return WornSensor(sensor, direct=True)


def unit_of(sensor: VirtualSensor, number: int) -> WornSensor:
    """Return a unit by its number: moulding, camera pose, light and rubber are drawn from it."""
    rng = np.random.default_rng([number, zlib.crc32(sensor.name.encode())])
    unit = UnitVariation.draw(rng, sensor)
    creep = Creep.draw(rng, CREEP_SHARE)
    if sensor.spec.signal != "camera":
        return WornSensor(sensor, unit, None, creep, lag_steps=LAG_STEPS)
    unit = unit.mounted(rng, Look())
    return WornSensor(sensor, unit, Light.draw(rng), creep, MARKER_LOSS, LAG_STEPS)
