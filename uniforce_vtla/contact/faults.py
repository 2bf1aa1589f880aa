"""Faults of a sensor, in physical doses: another pad, a moved camera, lost markers, a late stream.

Names after "+" in the words of a mounted sensor: ``tactip:1+flicker=0.2``. Ids of RoboTactile's
suite stand in ``benchmarks.stress`` where the fault is the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uniforce_vtla.contact.units import UnitVariation
from uniforce_vtla.contact.wear import Creep, Light
from uniforce_vtla.contact.worn import WornSensor

CONTROL_HZ = 30  # steps of lag and stall
CREEP_s = 0.6  # relaxation time of the creep that a fault brings
CAMERA = ("camera",)
TAXEL = ("taxel",)
EVERY = (*CAMERA, *TAXEL, "points")


@dataclass(frozen=True)
class Fault:
    """One kind of fault."""

    what: str  # in words
    unit: str  # of a dose
    # a worn unit and a dose → the unit with that fault
    put: Callable[[WornSensor, float], WornSensor]
    signals: tuple[str, ...] = EVERY  # kinds of sensor that can have it


def _unit(name: str) -> Callable[[WornSensor, float], WornSensor]:
    """Multiply a number of the unit, before its reference was taken and after."""

    def put(worn: WornSensor, dose: float) -> WornSensor:
        changed = replace(worn.unit, **{name: getattr(worn.unit, name) * dose})
        since = worn.since and replace(worn.since, **{name: getattr(worn.since, name) * dose})
        return replace(worn, unit=changed, since=since)

    return put


def _since(
    **change: Callable[[UnitVariation, float], Any],
) -> Callable[[WornSensor, float], WornSensor]:
    """Change the unit after its reference was taken."""

    def put(worn: WornSensor, dose: float) -> WornSensor:
        now = worn.since or worn.unit
        changed = {name: of(now, dose) for name, of in change.items()}
        return replace(worn, since=replace(now, **changed))

    return put


def _darker(worn: WornSensor, dose: float) -> WornSensor:
    light = worn.light or Light((1.0, 1.0, 1.0), (0.0, 0.0))
    r, g, b = (gain * dose for gain in light.gain)
    return replace(worn, light_since=replace(light, gain=(r, g, b)))


def _steps(dose_ms: float) -> int:
    return round(dose_ms / 1000 * CONTROL_HZ)


FAULTS = {
    "stiffness": Fault("pad stiffer or softer than this unit's", "×", _unit("stiffness")),
    "gain": Fault("markers or counts move more or less for the same force", "×", _unit("gain")),
    "shift": Fault(
        "camera moved after the reference",
        "mm on the pad",
        _since(view_shift_mm=lambda u, mm: (u.view_shift_mm[0] + mm, u.view_shift_mm[1])),
        CAMERA,
    ),
    "turn": Fault(
        "camera turned after the reference",
        "degrees",
        _since(view_turn_rad=lambda u, deg: u.view_turn_rad + float(np.radians(deg))),
        CAMERA,
    ),
    "lost": Fault(
        "markers gone after the reference", "share", _since(lost=lambda u, share: share), CAMERA
    ),
    "flicker": Fault(
        "markers missed at random",
        "chance per frame",
        lambda w, p: replace(w, marker_loss=p),
        CAMERA,
    ),
    "dead": Fault(
        "patch of markers or taxels that stands still", "share", _since(dead=lambda u, share: share)
    ),
    "crosstalk": Fault(
        "taxels that read their neighbours",
        "share",
        _since(crosstalk=lambda u, share: share),
        TAXEL,
    ),
    "light": Fault("another exposure after the reference", "×", _darker, CAMERA),
    "stale": Fault(
        "reference taken under load", "N", lambda w, force_N: replace(w, stale_N=force_N)
    ),
    "creep": Fault(
        "part of a motion that comes late",
        "share",
        lambda w, s: replace(w, creep=Creep(s, CREEP_s)),
    ),
    "lag": Fault(
        "images late by as much more",
        "ms",
        lambda w, ms: replace(w, lag_steps=w.lag_steps + _steps(ms)),
    ),
    "stall": Fault(
        "stream stands still, once in 2 s", "ms", lambda w, ms: replace(w, stall_steps=_steps(ms))
    ),
}
