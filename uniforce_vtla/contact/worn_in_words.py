"""Words by which commands name the sensor on a finger.

``tactip`` is unit 1 of that sensor, ``tactip:7`` another one, ``tactip:any`` a new one in every
scene. ``tactip:drawing`` is the fast path: the contact model's own marker image, without a frame.
``tactip:7+flicker=0.2+lag=100`` is unit 7 with two faults (``faults.FAULTS``).
"""

from collections.abc import Callable, Sequence

from uniforce_vtla.contact.faults import FAULTS
from uniforce_vtla.contact.virtual import any_virtual
from uniforce_vtla.contact.worn import WornSensor, drawing, unit_of
from uniforce_vtla.errors import SensorError, expected, nearest

USUAL_UNIT = "1"
ANY = "any"
DRAWING = "drawing"
Wear = Callable[[int], WornSensor]  # a scene's seed → the sensor mounted there


def wear(sensor: str | WornSensor) -> Wear:
    """Return which sensor is mounted on a finger in each scene.

    Raises SensorError: an unknown name or fault, or neither a number nor ``any`` nor ``drawing``.
    """
    if isinstance(sensor, WornSensor):
        return lambda seed: sensor
    words, *faults = sensor.split("+")
    name, _, which = words.partition(":")
    drawn = any_virtual(name)
    which = which or USUAL_UNIT
    if which == ANY:
        # no unit that a number names
        return lambda seed: with_faults(unit_of(drawn, 1_000_000 + seed), faults)
    if which == DRAWING:
        one = drawing(drawn)
    elif which.isdecimal() and int(which) < 1_000_000:
        one = unit_of(drawn, int(which))
    else:
        wanted = f"a number below 1,000,000, {ANY} or {DRAWING}"
        do = "Or leave it out: unit 1."
        raise SensorError(expected(f"unit of {name}", wanted, repr(which), do))
    one = with_faults(one, faults)
    return lambda seed: one


def with_faults(worn: WornSensor, faults: Sequence[str]) -> WornSensor:
    """Return a mounted unit with faults in words, ``flicker=0.2``.

    Raises SensorError: an unknown fault, one that this sensor type can't have, or no number.
    """
    for words in faults:
        name, _, dose = words.partition("=")
        fault = FAULTS.get(name)
        if fault is None or worn.sensor.spec.signal not in fault.signals:
            known = [
                name for name, fault in FAULTS.items() if worn.sensor.spec.signal in fault.signals
            ]
            raise SensorError(
                expected(
                    f"fault of {worn.sensor.name}",
                    " | ".join(known),
                    repr(name),
                    nearest(name, known, "Name one."),
                )
            )
        try:
            worn = fault.put(worn, float(dose))
        except ValueError as error:
            raise SensorError(
                expected(f"dose of {name}", f"a number [{fault.unit}]", repr(dose), "Say it.")
            ) from error
    return worn
