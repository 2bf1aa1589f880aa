"""Marker images per second of the contact model, one thread."""

from collections.abc import Callable
from itertools import cycle
from statistics import median
from typing import Any

import cv2
import numpy as np

from benchmarks.timing import repeated
from uniforce_vtla.contact import SEEN, TactileSimulator
from uniforce_vtla.contact.sampling import ForceRange, sample_loads, sample_objects
from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE, ContactState
from uniforce_vtla.sensors import list_sensors

_BATCHES = {"batched": 16, "batch2": 2}  # data generation, and two fingers of a control loop
_VARIANTS = 8  # different batches in turn, so that no single easy contact decides


def bench_contact(seconds: float) -> dict[str, Any]:
    """Return ``{"contact_images_per_s": {sensor: {"batched", "batch2"}, "median": …}, "anchors": {…}}``.

    From contact state (gap, force, torsion) to finished 640×480 marker image, noise included; contacts are
    drawn from the seen indenters and flat faces over the whole force range. ``seconds`` per measurement.
    """
    rates = {
        sensor: {
            name: _rate(_work(sensor, batch), batch, seconds) for name, batch in _BATCHES.items()
        }
        for sensor in list_sensors()
    }
    rates["median"] = {name: median(rate[name] for rate in rates.values()) for name in _BATCHES}
    return {
        "contact_images_per_s": rates,
        "anchors": {"draw_127_circles_cv2_per_s": _rate(_draw_circles, 1, seconds)},
    }


def _work(sensor: str, batch: int) -> Callable[[], object]:
    simulator, rng = TactileSimulator(sensor), np.random.default_rng(0)
    contacts = cycle([drawn_contact(rng, batch) for _ in range(_VARIANTS)])
    return lambda: simulator.marker_images(next(contacts))


def drawn_contact(rng: np.random.Generator, batch: int) -> ContactState:
    force, torsion = sample_loads(rng, batch, ForceRange())
    return ContactState(sample_objects(rng, batch, SEEN, flat_share=0.2).gap_mm, force, torsion)


def _draw_circles() -> None:
    image = np.zeros(MARKER_IMAGE_SHAPE, np.uint8)
    for index in range(127):
        cv2.circle(image, (20 + 40 * (index % 15), 20 + 40 * (index // 15)), 7, 255, cv2.FILLED)


def _rate(work: Callable[[], object], images: int, seconds: float) -> float:
    """Return images per second of ``work``, which makes ``images`` of them."""
    calls, spent = repeated(work, seconds)
    return round(images * calls / spent, 1)
