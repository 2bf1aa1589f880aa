"""TactileFusion: h5 files with GelSight Mini, 9DTact, Tac-02 or XELA uSkin signals and forces.

Frames of a gel go through ``Canonicalizer("gelsight")``, counts of 16 three-axis taxels through
``Canonicalizer("uskin")``; which one is decided by the data's form. The card of ``AllenBi21/TactileFusion`` names the
sensors only: names inside the files are looked for (``FusionKeys``), and nothing here was tried on the real files.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from uniforce_datasets.readers.files import existing_folder, find, require
from uniforce_datasets.readers.force_axes import ForceAxes
from uniforce_datasets.readers.fusion_keys import (
    FusionKeys,
    FusionNode,
    find_nodes,
    listing,
    own_item,
    read_dataset,
)
from uniforce_datasets.readers.recording import LabelledRecording
from uniforce_datasets.readers.trial import ReadOptions, Trial, recordings_of
from uniforce_vtla.contracts import TAXEL_SHAPE
from uniforce_vtla.errors import DatasetError, expected

ENDINGS = (".h5", ".hdf5")
ROWS_AT_ONCE = 64  # frames read in one go: 59 MB of 640×480 RGB


@dataclass(frozen=True)
class FusionConfig:
    """What to read of TactileFusion files.

    Attributes:
        sensors: any of "gsmini", "9dtact", "tac02", "uskin". The default leaves out 9DTact, whose gel has no
            markers (asked for, it raises the canonicaliser's error), and Tac-02, whose signal's form is not known.
        keys: names inside the files.
        axes: from the force sensor's axes to ours.
        options: reference and memory.
    """

    sensors: tuple[str, ...] = ("gsmini", "uskin")
    keys: FusionKeys = field(default_factory=FusionKeys)
    axes: ForceAxes = field(default_factory=ForceAxes)
    options: ReadOptions = field(default_factory=ReadOptions)


def h5_files(folder: str | Path) -> list[Path]:
    """Return the .h5 and .hdf5 files in ``folder`` or up to three levels below."""
    return sorted(path for ending in ENDINGS for path in find(Path(folder), f"*{ending}"))


def read_tactile_fusion(
    folder: str | Path, config: FusionConfig | None = None
) -> Iterator[LabelledRecording]:
    """Yield every trial of the asked sensors; the indenter is the file's name, the trial the path inside.

    Raises:
        ContractError: the package ``h5py`` is missing.
        DatasetError: no file, a truncated one, none of the sensors, names that aren't clear (the content is
            listed), a signal of unknown form, other counts of frames and forces, NaN, a pressed reference, or
            data that lies outside.
        SensorError: the canonicaliser's own, e.g. a gel without markers, or dead taxels.
    """
    config = config or FusionConfig()
    require("h5py")
    files = h5_files(existing_folder(folder))
    if not files:
        raise DatasetError(expected(str(folder), " or ".join(ENDINGS), "no such file", "Check the folder."))
    found = 0
    for path in files:
        with _open(path) as file:
            for sensor in config.sensors:
                nodes = find_nodes(file, sensor, config.keys, path)
                found += len(nodes)
                for node in nodes:
                    yield from recordings_of(_trial(file, path, sensor, node, config), config.options)
            if path == files[-1] and not found:
                wanted = f"a group or dataset for {' or '.join(config.sensors)}"
                raise DatasetError(expected(str(path), wanted, listing(file), "Name it in FusionKeys."))


def _open(path: Path) -> Any:
    try:
        return require("h5py").File(path, "r")
    except OSError as error:
        raise DatasetError(
            expected(str(path), "a whole h5 file", error, "Restore it from a copy.")
        ) from error


def _trial(file: Any, path: Path, sensor: str, node: FusionNode, config: FusionConfig) -> Trial:
    where = f"{path}, {node.signal}"
    signal = own_item(file, node.signal, path)
    kind = signal_kind(signal.shape, signal.dtype, where)
    recorded = read_dataset(file, node.force, path)
    if recorded.ndim != 2 or recorded.shape[1] < 3 or len(recorded) != len(signal):
        wanted = f"({len(signal)}, 3 or more), one row per frame"
        do = "Which force belongs to which frame can't be known."
        raise DatasetError(expected(f"{path}, {node.force}", wanted, recorded.shape, do))
    rows = partial(_rows, file, path, node.signal, kind)
    force_N = config.axes.to_image(recorded.astype(np.float64))
    free_air = _free_air(file, path, node, kind)
    return Trial(sensor, path.stem, node.trial, force_N, rows, kind, free_air)


def signal_kind(shape: tuple[int, ...], dtype: np.dtype, where: str) -> str:
    """Return the canonicaliser for a signal of this form: "gelsight" or "uskin".

    Raises:
        DatasetError: neither (T, H, W, 3) uint8 frames nor (T, 16, 3) or (T, 48) taxel counts.
    """
    if len(shape) == 4 and shape[3] == 3 and dtype == np.uint8:
        return "gelsight"
    if len(shape) in (2, 3) and int(np.prod(shape[1:])) == int(np.prod(TAXEL_SHAPE)):
        return "uskin"
    wanted = "(T, H, W, 3) uint8 frames, or (T, 16, 3) or (T, 48) taxel counts"
    do = "Other sensors need a canonicaliser of their own."
    raise DatasetError(expected(where, wanted, f"{dtype} {shape}", do))


def _rows(file: Any, path: Path, name: str, kind: str, first: int) -> Iterator[np.ndarray]:
    for start in range(first, len(own_item(file, name, path)), ROWS_AT_ONCE):
        block = read_dataset(file, name, path, slice(start, start + ROWS_AT_ONCE))
        yield from block if kind == "gelsight" else _counts(block, f"{path}, {name}")


def _counts(values: np.ndarray, where: str) -> np.ndarray:
    """Return (T, 16, 3) int64 counts; calibrated newtons are refused."""
    if not np.array_equal(values, np.rint(values)):  # NaN fails this too
        do = "Drawn are raw counts; calibrated forces have another scale."
        raise DatasetError(expected(where, "whole counts", "fractions or NaN", do))
    return values.astype(np.int64).reshape(-1, *TAXEL_SHAPE)


def _free_air(file: Any, path: Path, node: FusionNode, kind: str) -> np.ndarray | None:
    if not node.reference:
        return None
    stored = read_dataset(file, node.reference, path)
    frames = own_item(file, node.signal, path).shape[1:]
    if stored.shape not in (frames, (1, *frames)):
        raise DatasetError(
            expected(
                f"{path}, {node.reference}", f"one frame {frames}", stored.shape, "Is it another dataset?"
            )
        )
    one = stored.reshape(frames)
    return one if kind == "gelsight" else _counts(one[None], f"{path}, {node.reference}")[0]
