"""The contact model by the size of its cells: images per second against contacts solved on a finer mesh.

The truth is finite elements with friction, step by step. It shares library and constants with the fast model.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.charts.front import Point, publish
from benchmarks.finite_elements.__main__ import SENSORS, agreement
from benchmarks.finite_elements.contacts import Contact, solve_contacts
from benchmarks.speed.contact import drawn_contact
from benchmarks.timing import in_turns, repeated
from uniforce_cli.boundary import command, one_thread
from uniforce_vtla.contact import TactileSimulator
from uniforce_vtla.contact.virtual import VirtualSensor, as_virtual
from uniforce_vtla.options import Count, OutFolder, Seed
from uniforce_vtla.results_file import provenance, write_json

CELLS_mm = (1.25, 2.5, 3.75, 5.0)  # whole cells of the grid that objects are given on
BATCH = 16
TIMED_s = 0.5  # per measurement


@dataclass
class ContactChartCommand:
    """Time the contact model with smaller and larger cells, and compare it with finite elements; chart both.

    Example: python -m benchmarks.charts.contact contacts=40
    """

    contacts: Count = 40  # per sensor, each pressed and sheared
    seed: Seed = 5  # of the contacts
    rounds: Count = 5  # of timing, all cells in turns
    out: OutFolder = "outputs/charts"


def with_cells(sensor: VirtualSensor, cell_mm: float) -> VirtualSensor:
    """Return the sensor on cells of another size."""
    return replace(sensor, material=replace(sensor.material, cell_mm=cell_mm))


def images_per_s(sensors: dict[str, VirtualSensor], rounds: int) -> dict[str, float]:
    """Return the median rate of each, one thread, from contact to marker image in batches of 16."""
    contact = drawn_contact(np.random.default_rng(0), BATCH)
    simulators = {name: TactileSimulator(sensor) for name, sensor in sensors.items()}

    def drawing(simulator: TactileSimulator) -> Callable[[], object]:
        return lambda: simulator.marker_images(contact)

    def rate(call: Callable[[], object]) -> float:
        calls, spent = repeated(call, TIMED_s)
        return BATCH * calls / spent

    taken = in_turns(
        {name: drawing(simulator) for name, simulator in simulators.items()}, rounds, rate
    )
    return {name: median(rates) for name, rates in taken.items()}


def points(
    sensor: VirtualSensor, contacts: list[Contact], rounds: int
) -> tuple[list[Point], dict[str, Any]]:
    """Return a point per size of cells, and all that was compared.

    A point's score is what the motion of markers has in common with finite elements, 1 less the median relative
    error; pressed and sheared are its two ends.
    """
    sizes = {f"{size:g} mm": with_cells(sensor, size) for size in CELLS_mm}
    rates, found, kept = images_per_s(sizes, rounds), [], {}
    for name, variant in sizes.items():
        agreed = agreement(variant, contacts)
        low, high = sorted(1 - agreed[kind]["motion_error"] for kind in ("press", "shear"))
        default = variant.material.cell_mm == sensor.material.cell_mm
        found.append(Point(name, 1000 / rates[name], (low + high) / 2, low, high, default))
        kept[name] = agreed | {"images_per_s": rates[name]}
    return found, kept


@command(ContactChartCommand)
def main(config: ContactChartCommand) -> None:
    """Entry of ``python -m benchmarks.charts.contact``."""
    one_thread()
    cost, score = "ms per marker image, one core", "markers move as in finite elements"
    sensors: dict[str, Any] = {}
    path = Path(config.out) / "chart_contact.json"
    for name in tqdm(SENSORS, desc="sensors"):
        sensor = as_virtual(name)
        contacts = solve_contacts(np.random.default_rng(config.seed), sensor, config.contacts)
        shown, kept = points(sensor, contacts, config.rounds)
        picture = path.with_name(f"chart_contact_{name}.png")
        sensors[name] = publish(shown, picture, f"{name}, simulated", cost, score) | {
            "compared": kept
        }
    content = {"family": "contact", "sensors": sensors} | provenance()
    print(f"* on the front; written to {write_json(path, content)}")


if __name__ == "__main__":
    sys.exit(main())
