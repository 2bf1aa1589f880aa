"""The fast contact model against friction on finite elements: marker motion and depth of the same loads."""

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.finite_elements.contacts import PRESS_STEPS, Contact, fine_gel, solve_contacts
from uniforce_vtla.contact.elastic import influence
from uniforce_vtla.contact.responses import ContactOptions, PointMotion
from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.contact.traction import Traction
from uniforce_vtla.contact.virtual import VirtualSensor
from uniforce_vtla.contracts import ContactState

_LEAST_N = 0.2  # contacts that carry less are left out: their motion is below a camera's noise


def compare(sensor: VirtualSensor, n: int, seed: int, friction: float = 1.0) -> dict[str, Any]:
    """Return how well the fast model agrees with ``n`` contacts: correlation, slope, depth error."""
    contacts = solve_contacts(np.random.default_rng(seed), sensor, n, friction=friction)
    simulator = TactileSimulator(sensor, options=replace(ContactOptions().quiet(), friction=friction))
    points, scale = sensor.spec.layout_mm, 1 / sensor.material.stiffness
    fine, fast = (PointMotion(i, points, scale) for i in (influence(fine_gel(sensor)), simulator.pad.influence))
    rows: dict[str, list[tuple[str, float, float, float]]] = {"press": [], "shear": []}
    for contact in contacts:
        for kind, step in (("press", PRESS_STEPS - 1), ("shear", -1)):
            if contact.force_N[step, 2] >= _LEAST_N:
                rows[kind].append(_agreement(contact, step, simulator, fine, fast))
    return {kind: _summary(found) for kind, found in rows.items()}


def _agreement(
    contact: Contact, step: int, simulator: TactileSimulator, fine: PointMotion, fast: PointMotion
) -> tuple[str, float, float, float]:
    cells, every = contact.cells[step], np.arange(len(contact.cells[step].press_N))
    truth = Traction(every, cells.press_N[None].astype(np.float32), cells.shear_N[None].astype(np.float32))
    force, torsion = contact.force_N[step][None], contact.torsion_Nmm[step][None]
    state = ContactState(contact.gap_mm[None], force, torsion)
    wanted, found = fine(truth)[0, :2].ravel(), fast(simulator.traction(state))[0, :2].ravel()
    correlation, slope = np.corrcoef(wanted, found)[0, 1], wanted @ found / (wanted @ wanted)
    depth = simulator.depth_mm(state)[0] / contact.depth_mm[step]
    return contact.name, float(correlation), float(slope), float(abs(depth - 1))


def _summary(rows: list[tuple[str, float, float, float]]) -> dict[str, float]:
    numbers = np.array([row[1:] for row in rows])
    flat = np.array([row[0] == "flat" for row in rows])
    return {
        "n": len(rows),
        "correlation": float(np.median(numbers[:, 0])),
        "correlation_p10": float(np.quantile(numbers[:, 0], 0.1)),
        "slope": float(np.median(numbers[:, 1])),
        "slope_held_tools": float(np.median(numbers[flat, 1])),
        "depth_error": float(np.median(numbers[:, 2])),
    }
