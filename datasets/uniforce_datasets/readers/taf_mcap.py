"""TaF-style probing runs as MCAP: one file per run, a topic of gel frames and a topic of wrenches.

The public card of ``Voxel51/TaF-Tactile-Force`` names ``/tactile-camera`` (foxglove.CompressedVideo) and
``/force-torque``; how they are encoded it doesn't say. Read here: JSON and protobuf messages, compressed images
(JPEG, PNG) and compressed video (H.264, H.265 and other codecs of PyAV).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from uniforce_datasets.readers.files import existing_folder, find, require
from uniforce_datasets.readers.force_axes import ForceAxes
from uniforce_datasets.readers.mcap_messages import (
    MessageDecoder,
    Pictures,
    force_in,
    read_messages,
    read_topics,
)
from uniforce_datasets.readers.naming import choose
from uniforce_datasets.readers.recording import LabelledRecording
from uniforce_datasets.readers.trial import ReadOptions, Trial, recordings_of
from uniforce_vtla.errors import DatasetError, expected


@dataclass(frozen=True)
class McapConfig:
    """How to read MCAP files of a gel and a wrench.

    Attributes:
        tactile_topic: topic of gel frames; empty takes the only one that ``tactile_words`` names.
        wrench_topic: topic of wrenches; empty takes the only one that ``wrench_words`` names.
        tactile_words, wrench_words: topics looked for, the likeliest first.
        max_gap_s: a frame's force is the wrench nearest in time, and not further away than this.
        sensor: name for the recordings.
        canonicalise_as: registry name of the canonicaliser.
        axes: from the wrench's axes to ours.
        options: reference and memory.
    """

    tactile_topic: str = ""
    wrench_topic: str = ""
    tactile_words: tuple[str, ...] = ("/tactile-camera", "tactile", "gelsight", "gel")
    wrench_words: tuple[str, ...] = ("/force-torque", "wrench", "ft", "force")
    max_gap_s: float = 0.02  # less than a frame at 30 fps: no force is used for two frames
    sensor: str = "gelsight_mini"
    canonicalise_as: str = "gelsight"
    axes: ForceAxes = field(default_factory=ForceAxes)
    options: ReadOptions = field(default_factory=ReadOptions)


def mcap_files(folder: str | Path) -> list[Path]:
    """Return the ``*.mcap`` files in ``folder`` or up to three levels below."""
    return find(Path(folder), "*.mcap")


def read_taf_mcap(folder: str | Path, config: McapConfig | None = None) -> Iterator[LabelledRecording]:
    """Yield every run (one .mcap file) in ``folder``; the indenter is the name of the folder it is in.

    Raises:
        ContractError: the package ``mcap`` is missing.
        DatasetError: no file, a truncated one, missing or ambiguous topics (all are listed), a frame without a
            wrench near it, NaN, a pressed reference, or a path that leads outside.
        SensorError: the canonicaliser's own, e.g. a gel without markers.
    """
    config = config or McapConfig()
    require("mcap")
    files = mcap_files(existing_folder(folder))
    if not files:
        raise DatasetError(expected(str(folder), "*.mcap", "none", "Is this a folder of MCAP runs?"))
    for file in files:
        yield from recordings_of(_trial(file, config), config.options)


def _trial(file: Path, config: McapConfig) -> Trial:
    topics = read_topics(file)
    tactile = _topic(file, topics, config.tactile_topic, config.tactile_words, "tactile_topic")
    wrench = _topic(file, topics, config.wrench_topic, config.wrench_words, "wrench_topic")
    decode = MessageDecoder()
    frame_ns = np.array([message.log_ns for message in read_messages(file, tactile)], np.int64)
    wrenches = [
        (message.log_ns, force_in(decode(message), str(file))) for message in read_messages(file, wrench)
    ]
    force_N = config.axes.to_image(_nearest(frame_ns, wrenches, config.max_gap_s, file))
    signal = partial(_gel_frames, file, tactile)
    return Trial(config.sensor, file.parent.name, file.stem, force_N, signal, config.canonicalise_as)


def _nearest(
    frame_ns: np.ndarray, wrenches: list[tuple[int, np.ndarray]], max_gap_s: float, file: Path
) -> np.ndarray:
    """Return (T, 3) of each frame's nearest wrench in time."""
    if len(frame_ns) == 0 or not wrenches:
        came = f"{len(frame_ns)} frames and {len(wrenches)} wrenches"
        raise DatasetError(expected(str(file), "frames and wrenches", came, "Leave this run out."))
    wrench_ns = np.array([at for at, _ in wrenches], np.int64)
    after = np.searchsorted(wrench_ns, frame_ns).clip(1, max(len(wrench_ns) - 1, 1))
    both = np.stack([after - 1, after.clip(max=len(wrench_ns) - 1)])  # (2, T)
    gap_ns = np.abs(wrench_ns[both] - frame_ns)
    closer = gap_ns.argmin(axis=0)
    worst = int(gap_ns.min(axis=0).argmax())
    worst_s = float(gap_ns.min(axis=0)[worst]) / 1e9
    if worst_s > max_gap_s:
        wanted = f"a wrench within {max_gap_s:g} s of each of {len(frame_ns)} frames"
        came = f"{worst_s:.3f} s at frame {worst}, {len(wrenches)} wrenches in all"
        raise DatasetError(expected(str(file), wanted, came, "Allow more with max_gap_s, or leave it out."))
    return np.stack([force for _, force in wrenches])[both[closer, np.arange(len(frame_ns))]]


def _gel_frames(file: Path, topic: str, first: int) -> Iterator[np.ndarray]:
    return islice(_all_gel_frames(file, topic), first, None)


def _all_gel_frames(file: Path, topic: str) -> Iterator[np.ndarray]:
    decode, pictures = MessageDecoder(), Pictures(str(file))
    for message in read_messages(file, topic):
        yield from pictures(decode(message))
    yield from pictures.rest()


def _topic(file: Path, topics: dict[str, str], given: str, words: tuple[str, ...], name: str) -> str:
    found = choose(given, list(topics), words)
    if found is None:
        listed = ", ".join(f"{topic} ({schema})" for topic, schema in topics.items()) or "none"
        do = f"Name it: McapConfig({name}=…)."
        raise DatasetError(expected(f"topics of {file}", given or f"one for {name}", listed, do))
    return found
