"""Is the contact model right?  Finite elements against theory, and the fast model against finite elements."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.finite_elements import theory
from benchmarks.finite_elements.compare import compare
from uniforce_cli.boundary import command
from uniforce_vtla.contact.indenters import flat_face_gap
from uniforce_vtla.contact.pads import build_pad
from uniforce_vtla.contact.pressure import solve_pressure
from uniforce_vtla.contact.virtual import as_virtual, gel_of
from uniforce_vtla.options import Count, OutFolder, Seed
from uniforce_vtla.results_file import provenance, write_json

SENSORS = ("gelsight", "uskin", "tactip")
REAL_TACTIPS_N_per_mm = (3.3, 4.7)  # shared facts: six real units, as 0.1.0's head read them


@dataclass
class FiniteElementsCommand:
    """Check finite elements against theory and the fast contact model against them; write contact_model.json.

    Example: python -m benchmarks.finite_elements contacts=100 results=docs/results
    """

    contacts: Count = 100  # per sensor, each scored pressed and sheared
    seed: Seed = 5  # of the contacts; those of the frozen sets are others
    results: OutFolder = "outputs/finite_elements"  # contact_model.json


def dome_slope() -> float:
    """Return the TacTip's stiffness in N/mm under a flat face between 3 and 6 N."""
    tactip = as_virtual("tactip")
    face = flat_face_gap(np.zeros((2, 2)), np.full((2, 2), 60.0), np.zeros(2), np.zeros((2, 2)))
    depth = solve_pressure(build_pad(gel_of(tactip.spec, tactip.material)), face, np.array([3.0, 6.0])).depth_mm
    return float(3 / (depth[1] - depth[0]))


def measure(contacts: int, seed: int) -> dict[str, Any]:
    """Return every check."""
    parts: dict[str, Callable[[], Any]] = {
        "hertz": theory.hertz,
        "bonded_layer": theory.bonded_layer,
        "cattaneo_mindlin": theory.cattaneo_mindlin,
        "mesh_convergence": theory.mesh_convergence,
        "reciprocity": theory.reciprocity,
        "force_balance": theory.force_balance,
        "tactip_slope_N_per_mm": dome_slope,
    }
    parts |= {name: partial(compare, as_virtual(name), contacts, seed) for name in SENSORS}
    found = {name: part() for name, part in tqdm(parts.items(), desc="finite elements")}
    flat = [found[name] for name in SENSORS[:2]]
    return found | {
        "contact_model": {
            "press_r": min(f["press"]["correlation"] for f in flat),
            "shear_r": min(f["shear"]["correlation"] for f in flat),
            "depth_error": max(f["press"]["depth_error"] for f in flat),
        },
        "real_tactip_slopes_N_per_mm": REAL_TACTIPS_N_per_mm,
    }


@command(FiniteElementsCommand)
def main(settings: FiniteElementsCommand) -> None:
    """Entry of ``python -m benchmarks.finite_elements``."""
    content = measure(settings.contacts, settings.seed) | provenance()
    path = write_json(Path(settings.results) / "contact_model.json", content)
    print(f"worst flat pad: {content['contact_model']}; written to {path}")


if __name__ == "__main__":
    sys.exit(main())
