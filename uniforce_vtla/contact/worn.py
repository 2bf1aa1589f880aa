"""What a simulated finger wears: one unit of a sensor as a lab would find it, or the bare drawing.

In words, as commands take it: ``tactip`` is unit 1 of that sensor, ``tactip:7`` another one, ``tactip:any`` another one
in every scene, and ``tactip:drawing`` the fast path: the marker image as the contact model draws it, without a frame.
``tactip:7+flicker=0.2+lag=100`` is unit 7 with two faults (``faults.FAULTS``).
"""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from uniforce_vtla.contact.faults import FAULTS
from uniforce_vtla.contact.indenters import flat_face_gap
from uniforce_vtla.contact.raw_look import PixelNoise
from uniforce_vtla.contact.responses import ContactOptions
from uniforce_vtla.contact.simulator import TactileSimulator, free_air
from uniforce_vtla.contact.units import Look, UnitVariation
from uniforce_vtla.contact.virtual import VirtualSensor, any_virtual, get_material
from uniforce_vtla.contact.wear import Creep, Light
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.errors import SensorError, expected
from uniforce_vtla.markers.canonicalizer import Canonicalizer

USUAL_UNIT, ANY, DRAWING = "1", "any", "drawing"
CREEP_SHARE = (0.05, 0.20)  # part of a motion that comes late; rubbers .1–.3
MARKER_LOSS = 0.02  # chance per marker and frame that the camera misses it; ViTac 2024 draws .01
LAG_STEPS = 1  # 33 ms from exposure to image
STALE_SIDE_mm = 15.0
STALL_EVERY = 60  # control steps, 2 s


@dataclass(frozen=True)
class WornSensor:
    """One unit of a sensor on a finger.

    Cameras show raw frames, which the canonicalizer turns into marker images as on a robot; it may refuse one. The
    drawn stiffness decides the picture and the pad in MuJoCo.
    """

    sensor: VirtualSensor  # its drawing and material
    unit: UnitVariation = field(default_factory=UnitVariation)  # how this one differs from the drawing
    light: Light | None = None  # on its camera
    creep: Creep | None = None  # of its rubber
    marker_loss: float = 0.0  # chance per marker and frame
    lag_steps: int = 0  # control steps by which its picture is late
    since: UnitVariation | None = None  # the unit as it is now, if it changed after its reference was taken
    light_since: Light | None = None  # likewise
    stale_N: float = 0.0  # pressed on the pad while the reference was taken
    stall_steps: int = 0  # control steps out of every STALL_EVERY for which the picture stands still
    direct: bool = False  # True: the fast path, no raw frame

    @property
    def kind(self) -> str:
        """Registry name of the sensor whose body it has: decides the pad in the simulator and what a policy knows."""
        return self.sensor.like

    @property
    def stiffness(self) -> float:
        """Stiffness over the nominal one of its kind."""
        return self.unit.stiffness * self.sensor.material.stiffness / get_material(self.kind).stiffness


class WornView:
    """What a worn unit shows of contacts: contact model, raw frame under its light, canonicalizer.

    Creep and lag depend on time: the caller, which follows the contact, applies them.

    Args:
        worn: the unit; ``direct`` leaves raw frame and canonicalizer out.
        seed: draws the noise.
        pixel_noise: of raw frames, see ``ContactOptions``.
        register: see ``Canonicalizer``.

    Raises SensorError: the canonicalizer refuses the reference.
    """

    def __init__(
        self, worn: WornSensor, seed: int = 0, pixel_noise: PixelNoise = "sheet", register: bool = True
    ) -> None:
        options = ContactOptions(
            marker_loss=worn.marker_loss > 0, loss_probability=worn.marker_loss, pixel_noise=pixel_noise
        )
        self.worn, self.simulator = worn, TactileSimulator(worn.sensor, worn.unit, options, seed)
        self._canonicalizer, self._light = Canonicalizer(worn.kind, register=register), worn.light
        if worn.direct:
            stale = worn.stale_N > 0
            shown = self.simulator.marker_images(_left_on(worn.stale_N))[0] if stale else self.simulator.reference()
            self.reference = shown  # (480, 640) uint8
        else:
            raw = self._lit(self.simulator.raw_frames(_left_on(worn.stale_N)))[0]
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

    def _lit(self, raw: np.ndarray) -> np.ndarray:
        return raw if self._light is None else self._light.on(raw)


def _left_on(press_N: float) -> ContactState:
    """Return what is on a pad while its reference is taken: nothing, or a small flat thing that presses on it."""
    if not press_N:
        return free_air(1)
    gap = flat_face_gap(np.zeros((1, 2)), np.full((1, 2), STALE_SIDE_mm), np.zeros(1), np.zeros((1, 2)))
    return ContactState(gap, np.array([[0, 0, press_N]], np.float32), np.zeros(1, np.float32))


def drawing(sensor: VirtualSensor) -> WornSensor:
    """Return the sensor as it is drawn, by the fast path."""
    return WornSensor(sensor, direct=True)


def unit_of(sensor: VirtualSensor, number: int) -> WornSensor:
    """Return a unit by its number: moulding, camera pose, light and rubber are drawn from it."""
    rng = np.random.default_rng([number, zlib.crc32(sensor.name.encode())])
    unit, creep = UnitVariation.draw(rng, sensor), Creep.draw(rng, CREEP_SHARE)
    if sensor.spec.signal != "camera":
        return WornSensor(sensor, unit, None, creep, lag_steps=LAG_STEPS)
    return WornSensor(sensor, unit.mounted(rng, Look()), Light.draw(rng), creep, MARKER_LOSS, LAG_STEPS)


Wear = Callable[[int], WornSensor]  # a scene's seed → what is worn there


def wear(sensor: str | WornSensor) -> Wear:
    """Return what a finger wears in each scene.

    Raises SensorError: an unknown name, neither a number nor ``any`` nor ``drawing`` behind it, or an unknown fault.
    """
    if isinstance(sensor, WornSensor):
        return lambda seed: sensor
    words, *faults = sensor.split("+")
    name, _, which = words.partition(":")
    drawn, which = any_virtual(name), which or USUAL_UNIT
    if which == ANY:
        return lambda seed: with_faults(unit_of(drawn, 1_000_000 + seed), faults)  # no unit that a number names
    if which != DRAWING and not (which.isdecimal() and int(which) < 1_000_000):
        wanted, do = f"a number below 1,000,000, {ANY} or {DRAWING}", "Or leave it out: unit 1."
        raise SensorError(expected(f"unit of {name}", wanted, repr(which), do))
    one = with_faults(drawing(drawn) if which == DRAWING else unit_of(drawn, int(which)), faults)
    return lambda seed: one


def with_faults(worn: WornSensor, faults: Sequence[str]) -> WornSensor:
    """Return a worn unit with faults in words, ``flicker=0.2``.

    Raises SensorError: an unknown fault, one that this kind of sensor can't have, or no number behind it.
    """
    for words in faults:
        name, _, dose = words.partition("=")
        fault = FAULTS.get(name)
        if fault is None or worn.sensor.spec.signal not in fault.signals:
            known = [name for name, fault in FAULTS.items() if worn.sensor.spec.signal in fault.signals]
            raise SensorError(expected(f"fault of {worn.sensor.name}", " | ".join(known), repr(name), "Name one."))
        try:
            worn = fault.put(worn, float(dose))
        except ValueError as error:
            raise SensorError(expected(f"dose of {name}", f"a number [{fault.unit}]", repr(dose), "Say it.")) from error
    return worn
