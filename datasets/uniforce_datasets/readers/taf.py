"""TaF-style probing runs: raw gel frames with a six-axis wrench, as a LeRobot v3 dataset or as MCAP files.

Raw frames go through ``Canonicalizer("gelsight")``; gels without markers are refused by it. The LeRobot column names
of ``jiamig/taf-dataset`` were not known when this was written: they are found by name and shape, or given.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from uniforce_datasets.readers.files import decode_picture, existing_folder, find
from uniforce_datasets.readers.force_axes import ForceAxes
from uniforce_datasets.readers.naming import choose
from uniforce_datasets.readers.recording import LabelledRecording
from uniforce_datasets.readers.trial import ReadOptions, Trial, recordings_of
from uniforce_datasets.source import Episode, Source, episode_frames, read_source
from uniforce_vtla.errors import DatasetError, expected

INFO = "meta/info.json"
WRENCH_LENGTHS = (3, 6)  # force, or force and moment


@dataclass(frozen=True)
class TafConfig:
    """How to read a LeRobot dataset of a gel and a wrench.

    Attributes:
        tactile_key: video or image column of the raw gel; empty looks for one by ``tactile_words``.
        wrench_key: column of 3 or 6 floats, forces first, N; empty looks for one by ``wrench_words``.
        tactile_words, wrench_words: parts of a column's name, the likeliest first.
        sensor: name for the recordings.
        canonicalise_as: registry name of the canonicaliser.
        axes: from the wrench's axes to ours.
        options: reference and memory.
    """

    tactile_key: str = ""
    wrench_key: str = ""
    tactile_words: tuple[str, ...] = ("tactile", "gelsight", "gs_mini", "gsmini", "gel")
    wrench_words: tuple[str, ...] = ("wrench", "force_torque", "ft", "force")
    sensor: str = "gelsight_mini"
    canonicalise_as: str = "gelsight"
    axes: ForceAxes = field(default_factory=ForceAxes)
    options: ReadOptions = field(default_factory=ReadOptions)


def lerobot_roots(folder: str | Path) -> list[Path]:
    """Return the LeRobot datasets at or up to three levels below ``folder``."""
    return [path.parents[1] for path in find(Path(folder), INFO)]


def read_taf_lerobot(folder: str | Path, config: TafConfig | None = None) -> Iterator[LabelledRecording]:
    """Yield every episode of every LeRobot v3 dataset in ``folder``; the indenter is the dataset folder's name.

    Raises:
        DatasetError: no dataset, another version of the format, missing or ambiguous columns (all are listed),
            broken files, NaN, a pressed reference, or a path that leads outside.
        SensorError: the canonicaliser's own, e.g. a gel without markers.
    """
    config = config or TafConfig()
    root = existing_folder(folder)
    found = lerobot_roots(root)
    if not found:
        raise DatasetError(expected(str(root), INFO, "none", "Is this a LeRobot dataset?"))
    for dataset in found:
        yield from _episodes(read_source(dataset, within=root), config)


def _episodes(source: Source, config: TafConfig) -> Iterator[LabelledRecording]:
    tactile = tactile_column(source.features, config)
    wrench = wrench_column(source.features, config)
    recorded = source.columns((wrench,))[wrench]  # (N, 3 or 6)
    for episode in source.episodes:
        force = config.axes.to_image(recorded[episode.start : episode.start + episode.length])
        name = f"episode_{episode.index:06d}"
        signal = partial(_gel_frames, source, episode, tactile)
        trial = Trial(config.sensor, source.root.name, name, force, signal, config.canonicalise_as)
        yield from recordings_of(trial, config.options)


def tactile_column(features: dict[str, dict], config: TafConfig) -> str:
    """Return the column of raw gel frames; raise DatasetError listing all columns where it isn't clear."""
    visual = [key for key, feature in features.items() if feature.get("dtype") in ("video", "image")]
    found = choose(config.tactile_key, visual, config.tactile_words)
    return found or _unclear("a tactile camera (tactile_key)", features)


def wrench_column(features: dict[str, dict], config: TafConfig) -> str:
    """Return the column of forces; raise DatasetError listing all columns where it isn't clear."""
    fitting = [
        key
        for key, feature in features.items()
        if str(feature.get("dtype")).startswith("float")
        and tuple(feature.get("shape", ())) in {(n,) for n in WRENCH_LENGTHS}
    ]
    found = choose(config.wrench_key, fitting, config.wrench_words)
    return found or _unclear("a wrench of 3 or 6 floats (wrench_key)", features)


def _unclear(wanted: str, features: dict[str, dict[str, Any]]) -> str:
    columns = ", ".join(f"{key} ({f.get('dtype')} {f.get('shape')})" for key, f in features.items())
    raise DatasetError(expected("LeRobot columns", f"one for {wanted}", columns, "Name it in TafConfig."))


def _gel_frames(source: Source, episode: Episode, key: str, first: int) -> Iterator[np.ndarray]:
    if key in episode.videos:
        return episode_frames(episode.videos[key], episode.length, source.fps, first)
    return _stored_images(source, episode, key, first)


def _stored_images(source: Source, episode: Episode, key: str, first: int) -> Iterator[np.ndarray]:
    """Yield frames of an ``image`` column: encoded pictures inside the parquet files."""
    for file in sorted((source.root / "data").rglob("*.parquet")):
        try:
            batches = pq.ParquetFile(file).iter_batches(batch_size=64, columns=[key, "index"])
            rows = (row for batch in batches for row in batch.to_pylist())
            for row in rows:
                if episode.start + first <= row["index"] < episode.start + episode.length:
                    yield decode_picture(_embedded(row[key], file), f"{file}, {key}", colour=True)
        except (pa.ArrowInvalid, OSError) as error:
            raise DatasetError(expected(str(file), "a whole parquet file", error, "Restore it.")) from error


def _embedded(cell: Any, file: Path) -> bytes:
    data = cell.get("bytes") if isinstance(cell, dict) else None
    if not data:
        raise DatasetError(
            expected(str(file), "pictures inside the file", "a path or none", "Embed them: push_to_hub does.")
        )
    return data
