"""Kept pairs on disk, as a LeRobot dataset and in the UniForce-pair layout; a kill loses no chunk.

The dataset comes first and counts: a chunk is an episode, committed in one step, marker images
exact. The layout follows. Where a kill leaves it behind, ``PairStore`` writes the missing images
from the dataset when it opens.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uniforce_datasets.features import (
    MARKER_VIDEO_SHAPE,
    flat_column,
    scalar_column,
    vector_column,
    video_column,
)
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.readers.recording import PairRecording
from uniforce_datasets.readers.uniforce_pairs import write_uniforce_pairs
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.source import Episode, Source, episode_frames
from uniforce_robots.pairs.coverage import Coverage
from uniforce_robots.pairs.rig import RigFrame
from uniforce_vtla import keys
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.options import absolute

LAYOUT = "uniforce_pairs"
DATASET = "lerobot"
PATTERN = "uniforce"
MIN_CHUNK = 2  # LeRobot computes no statistics of fewer frames


@dataclass(frozen=True)
class Session:
    """A number that counts reference captures, and the references: finger → (480, 640) uint8."""

    number: int
    references: dict[Finger, np.ndarray]


@dataclass(frozen=True)
class Pair:
    """A kept pair."""

    frame: RigFrame  # images and motion
    force_N: dict[Finger, np.ndarray]  # finger → (3,) estimates, canonical frame
    error: float  # estimated equilibrium error

    @property
    def mean_force_N(self) -> np.ndarray:  # noqa: N802  a unit
        """(3,) of both fingers."""
        return (self.force_N["left"] + self.force_N["right"]) / 2

    def row(self) -> dict[str, Any]:
        """Return the frame with the dataset's keys, all but the chunk's own."""
        numbers = {
            keys.pair_force_key("left"): self.force_N["left"],
            keys.pair_force_key("right"): self.force_N["right"],
            keys.PAIR_ERROR: [self.error],
            keys.PAIR_VELOCITY: self.frame.velocity_m_s,
            keys.PAIR_ACCELERATION: self.frame.acceleration_m_s2,
            keys.PAIR_GRIP: [self.frame.grip_N],
        }
        row: dict[str, Any] = {key: np.asarray(value, np.float32) for key, value in numbers.items()}
        for finger, image in self.frame.images.items():
            row[keys.tactile_key(finger)] = image
        return row


def pair_features() -> dict[str, dict]:
    """Return LeRobot's features dict of recorded pairs."""
    features: dict[str, dict] = {key: video_column(MARKER_VIDEO_SHAPE) for key in keys.TACTILE_KEYS}
    for finger in FINGERS:
        features[keys.pair_force_key(finger)] = vector_column(["fx_N", "fy_N", "fz_N"])
    features |= {
        keys.PAIR_VELOCITY: vector_column(["x", "y", "z"]),
        keys.PAIR_ACCELERATION: vector_column(["x", "y", "z"]),
        keys.PAIR_ERROR: scalar_column("float32"),
        keys.PAIR_GRIP: scalar_column("float32"),
        keys.PAIR_INDENTER: flat_column(1, "int64"),
        keys.PAIR_SESSION: flat_column(1, "int64"),
    }
    for finger in FINGERS:
        features[keys.sensor_key(finger)] = flat_column(1, "int64")
    return features


class PairStore:
    """Appends chunks, or goes on with what is at ``root``.

    ``lerobot/`` and ``uniforce_pairs/`` lie below the root. Sensors are registry names, indenters
    names in the order of their indices. ``counts`` and ``coverage`` are of each indenter;
    ``next_session`` is the number of a session that begins now.

    Raises DatasetError: another recorder writes here, or other sensors, rates or features are
    there.
    """

    def __init__(
        self,
        root: str | Path,
        left_sensor: str,
        right_sensor: str,
        indenters: tuple[str, ...],
        rate_hz: int,
    ) -> None:
        self.root = absolute(root)
        self.indenters = indenters
        self.dataset = self.root / DATASET
        self.layout = self.root / LAYOUT
        self._names = (left_sensor, right_sensor)
        # the layout names left and right by folders, which two sensors of one type would share
        if left_sensor == right_sensor:
            self._names = (f"{left_sensor}_l", f"{right_sensor}_r")
        self._recorder = EpisodeRecorder(
            self.dataset,
            "local/uniforce_pairs",
            left_sensor,
            right_sensor,
            rate_hz,
            features=pair_features(),
        )
        self.coverage = [Coverage() for _ in indenters]
        self.next_session = 0
        if self._recorder.num_episodes:
            self._go_on(check_dataset(self.dataset))

    @property
    def counts(self) -> np.ndarray:
        """(N,) pairs of each indenter."""
        return np.array([covered.force.sum() for covered in self.coverage])

    def add(self, indenter: int, session: Session, pairs: Sequence[Pair]) -> None:
        """Store pairs of one indenter and one session durably.

        Raises ContractError: an unknown indenter, or fewer than two pairs; DatasetError: the disk
        is full, or a frame could not be stored; earlier pairs are intact.
        """
        if not 0 <= indenter < len(self.indenters) or len(pairs) < MIN_CHUNK:
            came = f"indenter {indenter}, {len(pairs)} pairs"
            wanted = f"one of {len(self.indenters)} indenters and ≥ {MIN_CHUNK} pairs"
            raise ContractError(expected("chunk", wanted, came, "Collect more before saving."))
        fixed = {keys.tactile_key(f, reference=True): session.references[f] for f in FINGERS}
        fixed |= {
            keys.PAIR_INDENTER: np.array([indenter]),
            keys.PAIR_SESSION: np.array([session.number]),
        }
        for pair in pairs:
            self._recorder.add(fixed | pair.row(), _instruction(self.indenters[indenter]))
        # a pair dataset has no such columns
        self._recorder.save(success=True, outcome="success", seed=0)
        self.coverage[indenter].add(np.array([pair.mean_force_N for pair in pairs]))
        self.next_session = max(self.next_session, session.number + 1)
        images = {f: np.stack([pair.frame.images[f] for pair in pairs]) for f in FINGERS}
        self._write_layout(indenter, session, images)

    def close(self) -> None:
        """Let others write here."""
        self._recorder.close()

    def __enter__(self) -> PairStore:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _go_on(self, source: Source) -> None:
        """Count what is there and bring the layout up to it."""
        left = keys.pair_force_key("left")
        right = keys.pair_force_key("right")
        columns = source.columns((keys.PAIR_INDENTER, keys.PAIR_SESSION, left, right))
        indenter = columns[keys.PAIR_INDENTER].reshape(-1)
        session = columns[keys.PAIR_SESSION].reshape(-1)
        if indenter.max() >= len(self.indenters):
            came = f"indenter {indenter.max()}"
            do = "Give the same indenters as before."
            raise DatasetError(
                expected(str(self.root), f"{len(self.indenters)} indenters", came, do)
            )
        held = source.instructions()
        force_N = (columns[left] + columns[right]) / 2
        for index in np.unique(indenter):
            self._check_name(index, set(held[indenter == index].tolist()))
            self.coverage[index].add(force_N[indenter == index])
        self.next_session = int(session.max()) + 1
        for place in sorted(set(zip(indenter.tolist(), session.tolist(), strict=True))):
            self._catch_up(source, *place, rows=(indenter == place[0]) & (session == place[1]))

    def _check_name(self, index: int, held: set[str]) -> None:
        """Refuse to go on with another object under an indenter's number."""
        wanted = _instruction(self.indenters[index])
        if held != {wanted}:
            do = "Give the same indenters in the same order, or another out."
            came = ", ".join(sorted(held))
            raise DatasetError(expected(f"indenter {index} of {self.root}", wanted, came, do))

    def _catch_up(self, source: Source, indenter: int, session: int, rows: np.ndarray) -> None:
        """Write the layout's images anew where they aren't as many as the dataset's."""
        pairs = self.layout / PATTERN / _date(session) / "_".join(self._names) / "marker"
        folders = [pairs / name / self.indenters[indenter] for name in self._names]
        if all(len(list(folder.glob("[0-9]*.jpg"))) == rows.sum() for folder in folders):
            return
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)
        for episode in source.episodes:
            if rows[episode.start]:
                references = {}
                images = {}
                for finger in FINGERS:
                    reference = _decoded(source, episode, keys.tactile_key(finger, True), 1)
                    references[finger] = reference[0]
                    images[finger] = _decoded(source, episode, keys.tactile_key(finger))
                self._write_layout(indenter, Session(session, references), images)

    def _write_layout(
        self, indenter: int, session: Session, images: Mapping[Finger, np.ndarray]
    ) -> None:
        left = session.references["left"]
        right = session.references["right"]
        name = self.indenters[indenter]
        pairs = PairRecording(self._names, name, "", left, right, images["left"], images["right"])
        write_uniforce_pairs(self.layout, pairs, PATTERN, _date(session.number))


def _instruction(indenter: str) -> str:
    return f"hold the {indenter}"


def _decoded(source: Source, episode: Episode, key: str, count: int = 0) -> np.ndarray:
    """Return (T, 480, 640) marker images of an episode: the first ``count``, or all."""
    frames = episode_frames(episode.videos[key], count or episode.length, source.fps)
    return np.stack([image[..., 0] for image in frames])


def _date(session: int) -> str:
    """Return the layout's second level: each session's references need a folder of their own."""
    return f"session_{session:03d}"
