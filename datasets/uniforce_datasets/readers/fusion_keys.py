"""What things are called inside a TactileFusion h5 file, and finding them by name and form."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uniforce_datasets.readers.files import require
from uniforce_datasets.readers.naming import choose, matching
from uniforce_vtla.errors import DatasetError, expected

LISTED = 40  # lines of a file's content shown in an error


@dataclass(frozen=True)
class FusionKeys:
    """Names to look for, the likeliest first; case, "-", "." and "_" don't matter.

    The public card of TactileFusion names its four sensors and nothing else, so these are guesses: an error lists
    what the file really holds, and the right names go here.

    Attributes:
        gsmini, ninedtact, tac02, uskin: a sensor's group, or its dataset itself.
        signal: frames or counts inside a sensor's group.
        force: (T, 3 or more) forces, inside the sensor's group or beside it.
        reference: one free-air frame or scan inside the sensor's group, if there is any.
    """

    gsmini: tuple[str, ...] = ("gsmini", "gs_mini", "gelsight_mini", "gelsight")
    ninedtact: tuple[str, ...] = ("9dtact", "ninedtact")
    tac02: tuple[str, ...] = ("tac02", "tac_02")
    uskin: tuple[str, ...] = ("uskin", "xela_uskin", "xela")
    signal: tuple[str, ...] = ("image", "images", "rgb", "frames", "img", "taxels", "counts", "raw", "data")
    force: tuple[str, ...] = ("force", "forces", "wrench", "ft", "force_torque")
    reference: tuple[str, ...] = ("reference", "ref", "background", "free_air")

    def of_sensor(self, sensor: str) -> tuple[str, ...]:
        """Return the names of ``sensor``: gsmini, 9dtact, tac02 or uskin; raise DatasetError for another."""
        names = {"gsmini": self.gsmini, "9dtact": self.ninedtact, "tac02": self.tac02, "uskin": self.uskin}
        if sensor not in names:
            raise DatasetError(expected("sensor", " | ".join(names), repr(sensor), "Choose one of these."))
        return names[sensor]


@dataclass(frozen=True)
class FusionNode:
    """One sensor's data of one trial inside a file: paths of its datasets.

    Attributes:
        trial: name within the file.
        signal, force: paths of datasets.
        reference: path, or "" for none.
    """

    trial: str
    signal: str
    force: str
    reference: str


def find_nodes(file: Any, sensor: str, keys: FusionKeys, path: Path) -> list[FusionNode]:
    """Return where ``sensor``'s data is, one node per trial; empty where the file has no such sensor.

    A sensor may be a dataset with the force beside it, a group that holds both, or a group of such groups, one per
    trial; and all that at any depth.

    Raises:
        DatasetError: the sensor is there, but its signal or its force isn't clear; everything is listed.
    """
    words = keys.of_sensor(sensor)
    nodes = []
    for group in _groups(file):
        if matching([group.name.rsplit("/", 1)[-1]], words):
            continue  # the sensor's own group: found from the one that holds it
        for name in matching(list(group), words):
            nodes += _nodes(file, group, own_item(group, name, path), keys, path)
    return nodes


def _nodes(file: Any, outer: Any, item: Any, keys: FusionKeys, path: Path) -> list[FusionNode]:
    h5py = require("h5py")
    beside = _chosen(outer, keys.force)
    if isinstance(item, h5py.Dataset):
        return [_checked(file, FusionNode(item.name.strip("/"), item.name, beside, ""), keys, path)]
    groups = [item] if _datasets(item) else [own_item(item, name, path) for name in item]
    return [
        _checked(
            file,
            FusionNode(
                group.name.strip("/"),
                _chosen(group, keys.signal),
                _chosen(group, keys.force) or beside,
                _chosen(group, keys.reference),
            ),
            keys,
            path,
        )
        for group in groups
    ]


def _chosen(group: Any, words: tuple[str, ...]) -> str:
    """Return the path of the one dataset in ``group`` that is meant, or ""."""
    name = choose("", _datasets(group), words)
    return f"{group.name.rstrip('/')}/{name}" if name else ""


def _checked(file: Any, node: FusionNode, keys: FusionKeys, path: Path) -> FusionNode:
    if node.signal and node.force:
        return node
    missing = "force" if node.signal else "signal"
    wanted = f"one dataset for the {missing} of {node.trial} ({', '.join(getattr(keys, missing))})"
    raise DatasetError(expected(str(path), wanted, listing(file), f"Name it in FusionKeys.{missing}."))


def listing(file: Any) -> str:
    """Return what a file holds: path, shape and type of every dataset."""
    h5py = require("h5py")
    lines: list[str] = []

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            lines.append(f"{name} {item.shape} {item.dtype}")

    file.visititems(note)
    more = f"; and {len(lines) - LISTED} more" if len(lines) > LISTED else ""
    return "; ".join(lines[:LISTED]) + more if lines else "nothing"


def read_dataset(file: Any, name: str, path: Path, rows: slice | None = None) -> np.ndarray:
    """Return (some rows of) a dataset of numbers.

    Raises:
        DatasetError: damaged, no numbers, or stored in another file.
    """
    item = own_item(file, name, path)
    if item.dtype.kind not in "biuf":
        raise DatasetError(expected(f"{path}, {name}", "numbers", item.dtype, "Is it another dataset?"))
    try:
        return item[()] if rows is None else item[rows]
    except (OSError, RuntimeError) as error:
        raise DatasetError(expected(f"{path}, {name}", "whole data", error, "Restore the file.")) from error


def own_item(group: Any, name: str, path: Path) -> Any:
    """Return the item at ``name``; raise DatasetError where its data lies in another file or behind a soft link."""
    h5py = require("h5py")
    item = group
    for part in name.strip("/").split("/"):
        if not isinstance(item.get(part, getlink=True), h5py.HardLink):
            raise DatasetError(_elsewhere(path, name))
        item = item[part]
    if isinstance(item, h5py.Dataset) and (item.external or item.is_virtual):
        raise DatasetError(_elsewhere(path, name))
    return item


def _elsewhere(path: Path, name: str) -> str:
    return expected(f"{path}, {name}", "data inside the file", "a link or storage elsewhere", "Copy it in.")


def _datasets(group: Any) -> list[str]:
    """Return the names of datasets; links are among them, so that choosing one is refused, not overlooked."""
    h5py = require("h5py")
    hard = {name: isinstance(group.get(name, getlink=True), h5py.HardLink) for name in group}
    return [name for name in group if not hard[name] or isinstance(group[name], h5py.Dataset)]


def _groups(file: Any) -> list[Any]:
    """Return the root and every group below it; links are not followed."""
    h5py = require("h5py")
    found = [file]
    file.visititems(lambda _, item: found.append(item) if isinstance(item, h5py.Group) else None)
    return found
