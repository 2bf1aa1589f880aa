"""Users' recordings → windows at the model's size → the force table on them."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import (
    POOL,
    Table,
    descriptor_row,
    encode_set,
    learnt_row,
    mean_row,
)
from uniforce_datasets.readers import read_genforce
from uniforce_datasets.readers.recording import LabelledRecording
from uniforce_vtla.contact.indenters import SEEN, UNSEEN
from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.descriptor import describe
from uniforce_vtla.tokenizer.pair_cache import shrink

log = logging.getLogger(__name__)
LENGTH = 12  # frames of a window, as in the simulated sets
MIN_SHEAR_N = 0.2  # frames with less say nothing about the direction of shear


def to_labelled_set(
    recordings: Iterable[LabelledRecording], side: int, length: int = LENGTH
) -> LabelledSet:
    """Return one sensor's recordings as n windows of T frames, end to end, at the model's size.

    Full-size images are dropped recording by recording; (T + 1) · side² bytes stay per window, T
    being ``length``.

    Raises DatasetError: several sensors, no window at all, or a reference with too few markers.
    """
    digest, sensor, too_short = hashlib.sha256(), "", 0
    rows: list[tuple[np.ndarray, ...]] = []
    for recording in recordings:
        if sensor not in ("", recording.sensor):
            came = f"{sensor} and {recording.sensor}"
            raise DatasetError(
                expected("labelled set", "one sensor", came, "Choose one with of_sensor.")
            )
        if not sensor:
            sensor = recording.sensor
            digest.update(sensor.encode())
        too_short += len(recording.frames) < length
        rows += _windows(recording, side, length, digest)
    if not rows:
        came = f"none; {too_short} recordings are shorter"
        do = "Is the folder right? Or shorten them."
        raise DatasetError(expected("labelled set", f"a window of {length} frames", came, do))
    if too_short:
        log.warning("%s: %d recordings shorter than a window left out", sensor, too_short)
    reference, frames, descriptor, force_N = (
        np.stack(column) for column in zip(*rows, strict=True)
    )
    digest.update(np.ascontiguousarray(force_N).tobytes())
    return LabelledSet(reference, frames, descriptor, force_N, digest.hexdigest())


def _windows(
    recording: LabelledRecording, side: int, length: int, digest: hashlib._Hash
) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield each window's reference, frames, descriptors, forces; digest the full-size images."""
    small = shrink(recording.reference[None], side)[0]
    packed = np.packbits(recording.reference > 0).tobytes()
    for start in range(0, len(recording.frames) - length + 1, length):
        rows = slice(start, start + length)
        frames = recording.frames[rows]  # (T, H, W)
        digest.update(packed + np.packbits(frames > 0).tobytes())
        yield small, shrink(frames, side), _described(recording, frames), recording.force_N[rows]


def _described(recording: LabelledRecording, frames: np.ndarray) -> np.ndarray:
    try:
        return describe(recording.reference, frames)
    except ContractError as error:
        raise DatasetError(f"{recording}: {error}") from error


def of_sensor(recordings: Iterable[LabelledRecording], sensor: str) -> Iterator[LabelledRecording]:
    return (recording for recording in recordings if recording.sensor == sensor)


def of_indenters(
    recordings: Iterable[LabelledRecording], indenters: Collection[str]
) -> Iterator[LabelledRecording]:
    return (recording for recording in recordings if recording.indenter in indenters)


def shear_agreement(labelled: LabelledSet) -> np.ndarray:
    """Return (2,) correlations of the markers' mean motion with shear force, x and y.

    A flat pad's markers are dragged the way the object pushes. So both must be clearly positive; a
    negative one says that this axis needs the other sign in ``ForceAxes``, two near zero that x and
    y may be swapped. A dome says little: where it is pressed moves its pins more than shear does
    (0.0 to 0.4, real TacTips alike).
    NaN where there is no shear.
    """
    motion = labelled.descriptor[..., :2].reshape(-1, 2)
    shear = labelled.force_N[..., :2].reshape(-1, 2)
    sheared = np.hypot(*shear.T) >= MIN_SHEAR_N
    if sheared.sum() < 3:
        return np.full(2, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.array(
            [np.corrcoef(motion[sheared, axis], shear[sheared, axis])[0, 1] for axis in range(2)]
        )


def user_data(tokenizer: Tokenizer, folder: str, seeds: int, results: Path) -> str:
    """Write the force table on a user's GenForce recordings, from seen to unseen indenters.

    Raises DatasetError: an unknown format, or fewer than two sensors with both kinds of indenters.
    """
    side = tokenizer.config.side
    sensors = sorted({recording.sensor for recording in read_genforce(folder)})
    if len(sensors) < 2:
        do = "A transfer needs a source and a target sensor."
        raise DatasetError(expected(folder, "two sensors or more", sensors, do))

    def sets(indenters: tuple[str, ...]) -> dict[str, LabelledSet]:
        found = {s: of_indenters(of_sensor(read_genforce(folder), s), indenters) for s in sensors}
        return {s: to_labelled_set(recordings, side) for s, recordings in found.items()}

    table = Table(sets(SEEN), sets(UNSEEN))
    content: dict[str, Any] = {
        "what": f"GenForce recordings in {folder}; heads: seen → unseen indenters",
        "tokenizer_hash": tokenizer.hash,
        "seeds": seeds,
        "shear_agreement": {s: shear_agreement(table.training[s]).tolist() for s in sensors},
        "rows": {
            "UniForce": learnt_row(table, lambda s: encode_set(tokenizer, s), seeds, POOL),
            "hand descriptor": descriptor_row(table, seeds),
            "mean": mean_row(table),
        },
    }
    path = write_json(results / "force_on_data.json", content | provenance())
    row = content["rows"]["UniForce"]
    lines = [
        f"{name}: R² {', '.join(f'{value:.2f}' for value in cell['r2'])}"
        for name, cell in row.items()
    ]
    return "\n".join(
        [*lines, f"written to {path}; check shear_agreement: −1 there means a wrong sign"]
    )
