"""``uniforce_view.json``: what a training view says of itself, checked before any of its arrays is opened."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from uniforce_datasets.dataset_paths import check_links
from uniforce_datasets.view_plan import FORMAT, TOUCH_STREAMS, touch_stream
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import ACTION, CAMERAS, STATE, VIEW_MARKER

COUNTS = ("image_side", "latent_grid", "fps", "num_frames")
TOUCH = tuple(touch_stream(name, finger) for name in TOUCH_STREAMS for finger in FINGERS)


def read_marker(root: Path) -> dict[str, Any]:
    """Return a view's facts.

    Raises:
        DatasetError: not a whole view of this format, damaged facts, or a link that leads out of the folder.
    """
    file = root / VIEW_MARKER
    if not file.is_file():
        raise DatasetError(expected(str(root), VIEW_MARKER, "none", "Build the view with uniforce view."))
    check_links(root, root)
    marker = read_object(file, DatasetError)
    missing = [name for name in (*CAMERAS, STATE, ACTION, *TOUCH) if not (root / f"{name}.npy").is_file()]
    if marker.get("format") != FORMAT or missing:
        came = f"format {marker.get('format')}, missing {missing}"
        raise DatasetError(expected(str(root), f"a whole view of format {FORMAT}", came, "Build it again."))
    if not (
        _counted(marker) and _described(marker) and _filled(marker.get("episodes"), marker["num_frames"])
    ):
        raise DatasetError(expected(str(file), "the facts of a view", "others", "Build it again."))
    return marker


def _counted(marker: dict[str, Any]) -> bool:
    return all(type(marker.get(name)) is int and marker[name] > 0 for name in COUNTS)


def _described(marker: dict[str, Any]) -> bool:
    sensors, slots = marker.get("sensors"), marker.get("slots")
    named = isinstance(sensors, dict) and all(_words(kinds) for kinds in sensors.values())
    filled = isinstance(slots, dict) and _words(list(slots.values()))
    return named and filled and isinstance(marker.get("wrench"), bool)


def _filled(episodes: object, frames: int) -> bool:
    """Whether these are episodes, and together as long as the view."""
    if not isinstance(episodes, list) or not all(isinstance(e, dict) for e in episodes):
        return False
    lengths = [e.get("length") for e in episodes]
    whole = all(type(length) is int and length > 0 for length in lengths)
    words = [e.get(name) for e in episodes for name in ("task", "left_sensor", "right_sensor")]
    return whole and sum(lengths) == frames and _words(words)


def _words(values: object) -> bool:
    return isinstance(values, list) and all(isinstance(value, str) for value in values)
