"""A folder → its recordings, whatever format it is in."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from uniforce_datasets.readers.files import existing_folder
from uniforce_datasets.readers.genforce import genforce_root, read_genforce
from uniforce_datasets.readers.recording import LabelledRecording, PairRecording
from uniforce_datasets.readers.tactile_fusion import h5_files, read_tactile_fusion
from uniforce_datasets.readers.taf import lerobot_roots, read_taf_lerobot
from uniforce_datasets.readers.taf_mcap import mcap_files, read_taf_mcap
from uniforce_datasets.readers.uniforce_pairs import PairConfig, pair_folders, read_uniforce_pairs
from uniforce_vtla.errors import DatasetError, expected


@dataclass(frozen=True)
class Format:
    """A data set format: how to tell it by its layout, and how to read it."""

    name: str
    layout: str
    found: Callable[[Path], object]
    read: Callable[[Path], Iterator[LabelledRecording]]


FORCE_FORMATS = (
    Format("genforce", "img/ and force/, or (dataset/)training/hetero/", genforce_root, read_genforce),
    Format("taf_lerobot", "meta/info.json of a LeRobot v3 dataset", lerobot_roots, read_taf_lerobot),
    Format("taf_mcap", "*.mcap", mcap_files, read_taf_mcap),
    Format("tactile_fusion", "*.h5 or *.hdf5", h5_files, read_tactile_fusion),
)
PAIR_LAYOUT = "<pattern>/<date>/<left>_<right>/collection_log.txt"


@dataclass(frozen=True)
class ForceSet:
    """Force-labelled recordings of a folder; each iteration reads it anew, one recording at a time.

    Attributes:
        format: name of the format found.
        folder: the folder.
    """

    format: str
    folder: Path
    _read: Callable[[Path], Iterator[LabelledRecording]]

    def __iter__(self) -> Iterator[LabelledRecording]:
        """Yield the recordings; raises what the format's reader raises."""
        return self._read(self.folder)


@dataclass(frozen=True)
class PairSet:
    """Pairs of a folder; each iteration reads it anew, one recording at a time."""

    folder: Path
    config: PairConfig

    def __iter__(self) -> Iterator[PairRecording]:
        """Yield the recordings; raises what ``read_uniforce_pairs`` raises."""
        return read_uniforce_pairs(self.folder, self.config)


def force_set(
    folder: str | Path, read: Callable[[Path], Iterator[LabelledRecording]] | None = None
) -> ForceSet:
    """Return the force-labelled set in ``folder``, its format told by its layout.

    Args:
        folder: what to read.
        read: a reader with settings of its own, e.g. ``partial(read_genforce, config=…)``; None detects one and
            uses its defaults.

    Raises:
        DatasetError: no known layout, or more than one; the layouts looked for are listed.
    """
    root = existing_folder(folder)
    if read is not None:
        return ForceSet(getattr(read, "__name__", "own"), root, read)
    fitting = [format for format in FORCE_FORMATS if format.found(root)]
    if len(fitting) != 1:
        wanted = "one of: " + "; ".join(f"{format.name} ({format.layout})" for format in FORCE_FORMATS)
        came = " and ".join(format.name for format in fitting) or _content(root)
        do = "Give the folder of one data set." if fitting else "Is it unpacked? See docs/data_readers.md."
        raise DatasetError(expected(f"data set in {root}", wanted, came, do))
    return ForceSet(fitting[0].name, root, fitting[0].read)


def pair_set(folder: str | Path, config: PairConfig | None = None) -> PairSet:
    """Return the pairs in ``folder``.

    Raises:
        DatasetError: no folder of the layout.
    """
    root = existing_folder(folder)
    if not pair_folders(root):
        do = "Pairs are two sensors' marker images with equal indices; see docs/data_readers.md."
        raise DatasetError(expected(f"pairs in {root}", PAIR_LAYOUT, _content(root), do))
    return PairSet(root, config or PairConfig())


def _content(root: Path) -> str:
    names = sorted(path.name + "/" * path.is_dir() for path in root.iterdir())
    return ", ".join(names[:8]) + (" …" if len(names) > 8 else "") if names else "an empty folder"
