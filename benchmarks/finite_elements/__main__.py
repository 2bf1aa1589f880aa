"""Finite elements against theory, and the fast contact model against finite elements."""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.finite_elements import theory
from benchmarks.finite_elements.contacts import PRESS_STEPS, Contact, fine_gel, solve_contacts
from uniforce_cli.boundary import command
from uniforce_vtla.contact import TactileSimulator, flat_face_gap
from uniforce_vtla.contact.elastic import influence
from uniforce_vtla.contact.pads import build_pad
from uniforce_vtla.contact.pressure import solve_pressure
from uniforce_vtla.contact.responses import ContactOptions, PointMotion
from uniforce_vtla.contact.sampling import FLAT
from uniforce_vtla.contact.traction import Traction
from uniforce_vtla.contact.virtual import VirtualSensor, as_virtual, gel_of
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.options import Count, OutFolder, Seed
from uniforce_vtla.results_file import provenance, write_json

SENSORS = ("gelsight", "uskin", "tactip")
REAL_TACTIPS_N_per_mm = (3.3, 4.7)  # shared facts: six real units, as 0.1.0's head read them
_LEAST_N = 0.2  # contacts that carry less are left out: their motion is below a camera's noise


@dataclass
class FiniteElementsCommand:
    """Check finite elements against theory, and the fast contact model against them.

    Example: python -m benchmarks.finite_elements contacts=100 results=docs/results
    """

    contacts: Count = 100  # per sensor, each scored pressed and sheared
    seed: Seed = 5  # of the contacts; those of the frozen sets are others
    results: OutFolder = "outputs/finite_elements"  # contact_model.json


def dome_slope() -> float:
    """Return the TacTip's stiffness in N/mm under a flat face between 3 and 6 N."""
    tactip = as_virtual("tactip")
    pad = build_pad(gel_of(tactip.spec, tactip.material))
    face = flat_face_gap(np.zeros((2, 2)), np.full((2, 2), 60.0), np.zeros(2), np.zeros((2, 2)))
    depth_mm = solve_pressure(pad, face, np.array([3.0, 6.0])).depth_mm
    return float(3 / (depth_mm[1] - depth_mm[0]))


def measure(contacts: int, seed: int) -> dict[str, Any]:
    parts: dict[str, Callable[[], Any]] = {
        "hertz": theory.hertz,
        "bonded_layer": theory.bonded_layer,
        "cattaneo_mindlin": theory.cattaneo_mindlin,
        "mesh_convergence": theory.mesh_convergence,
        "reciprocity": theory.reciprocity,
        "force_balance": theory.force_balance,
        "tactip_slope_N_per_mm": dome_slope,
    }
    for name in SENSORS:
        parts[name] = partial(compare, as_virtual(name), contacts, seed)
    found = {name: part() for name, part in tqdm(parts.items(), desc="finite elements")}
    flat = [found[name] for name in SENSORS[:2]]
    found["contact_model"] = {
        "press_r": min(f["press"]["correlation"] for f in flat),
        "shear_r": min(f["shear"]["correlation"] for f in flat),
        "depth_error": max(f["press"]["depth_error"] for f in flat),
    }
    found["real_tactip_slopes_N_per_mm"] = REAL_TACTIPS_N_per_mm
    return found


def compare(sensor: VirtualSensor, n: int, seed: int) -> dict[str, Any]:
    """Return how well the fast model agrees with ``n`` contacts solved on a finer mesh."""
    contacts = solve_contacts(np.random.default_rng(seed), sensor, n)
    simulator = TactileSimulator(sensor, options=replace(ContactOptions().quiet(), friction=1.0))
    points_mm = sensor.spec.layout_mm
    scale = 1 / sensor.material.stiffness
    fine = PointMotion(influence(fine_gel(sensor)), points_mm, scale)
    fast = PointMotion(simulator.pad.influence, points_mm, scale)
    found = {}
    for kind, step in (("press", PRESS_STEPS - 1), ("shear", -1)):
        rows = []
        names = []
        for contact in contacts:
            if contact.force_N[step, 2] >= _LEAST_N:
                rows.append(_agreement(contact, step, simulator, fine, fast))
                names.append(contact.name)
        correlation, slope, depth_error, motion_error = np.array(rows).T
        found[kind] = {
            "n": len(rows),
            "correlation": float(np.median(correlation)),
            "correlation_p10": float(np.quantile(correlation, 0.1)),
            "slope": float(np.median(slope)),
            "slope_held_tools": float(np.median(slope[np.array(names) == FLAT])),
            "depth_error": float(np.median(depth_error)),
            "motion_error": float(np.median(motion_error)),
        }
    return found


def _agreement(
    contact: Contact, step: int, simulator: TactileSimulator, fine: PointMotion, fast: PointMotion
) -> tuple[Any, Any, Any, Any]:
    """Return correlation and slope of the markers' motion, and the errors of depth and motion."""
    cells = contact.cells[step]
    press_N = cells.press_N[None].astype(np.float32)
    shear_N = cells.shear_N[None].astype(np.float32)
    truth = Traction(np.arange(press_N.shape[1]), press_N, shear_N)
    force_N = contact.force_N[step][None]
    state = ContactState(contact.gap_mm[None], force_N, contact.torsion_Nmm[step][None])
    wanted = fine(truth)[0, :2].ravel()
    found = fast(simulator.traction(state))[0, :2].ravel()
    return (
        np.corrcoef(wanted, found)[0, 1],
        wanted @ found / (wanted @ wanted),
        abs(simulator.depth_mm(state)[0] / contact.depth_mm[step] - 1),
        np.linalg.norm(found - wanted) / np.linalg.norm(wanted),
    )


@command(FiniteElementsCommand)
def main(settings: FiniteElementsCommand) -> None:
    content = measure(settings.contacts, settings.seed) | provenance()
    path = write_json(Path(settings.results) / "contact_model.json", content)
    print(f"worst flat pad: {content['contact_model']}; written to {path}")


if __name__ == "__main__":
    sys.exit(main())
