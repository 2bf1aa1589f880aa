"""Kept pairs on disk, twice: as a LeRobot dataset and in the UniForce-pair layout. Each saved chunk survives a kill.

The dataset comes first and is the one that counts: a chunk is an episode, committed in one step, marker images exact.
The layout follows; where a kill leaves it behind, ``PairStore`` writes the missing images from the dataset when it
opens.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from uniforce_datasets.features import MARKER_VIDEO_SHAPE
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.readers.recording import PairRecording
from uniforce_datasets.readers.uniforce_pairs import write_uniforce_pairs
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.source import Episode, Source, episode_frames
from uniforce_pair_recording.coverage import Coverage
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.keys import (
    PAIR_ACCELERATION,
    PAIR_ERROR,
    PAIR_GRIP,
    PAIR_INDENTER,
    PAIR_PLACE,
    PAIR_SESSION,
    PAIR_VELOCITY,
    TACTILE_KEYS,
    pair_force_key,
    sensor_key,
    tactile_key,
)

LAYOUT, DATASET = "uniforce_pairs", "lerobot"
PATTERN = "uniforce"
MIN_CHUNK = 2  # LeRobot computes no statistics of fewer frames


@dataclass(frozen=True)
class PairChunk:
    """Pairs of one indenter and one pair of references, n of them.

    Attributes:
        indenter: index into the recording's indenters.
        session: counts reference captures.
        references: finger → (480, 640) uint8.
        images: finger → (n, 480, 640) uint8, as each sensor saw them.
        force_N: finger → (n, 3) estimates, canonical frame.
        place: (n, 2) estimated, see ``coverage.contact_place``.
        error: (n,) estimated equilibrium error.
        velocity_m_s, acceleration_m_s2: (n, 3) of the hand.
        grip_N: (n,) the gripper's estimate.
    """

    indenter: int
    session: int
    references: dict[Finger, np.ndarray]
    images: dict[Finger, np.ndarray]
    force_N: dict[Finger, np.ndarray]
    place: np.ndarray
    error: np.ndarray
    velocity_m_s: np.ndarray
    acceleration_m_s2: np.ndarray
    grip_N: np.ndarray

    def __len__(self) -> int:
        return len(self.error)

    def rows(self) -> list[dict[str, Any]]:
        """Return the chunk's frames with the dataset's keys."""
        fixed: dict[str, Any] = {tactile_key(f, reference=True): self.references[f] for f in FINGERS}
        fixed |= {PAIR_INDENTER: np.array([self.indenter]), PAIR_SESSION: np.array([self.session])}
        return [fixed | self._row(k) for k in range(len(self))]

    def _row(self, k: int) -> dict[str, Any]:
        row: dict[str, Any] = {tactile_key(f): self.images[f][k] for f in FINGERS}
        row |= {pair_force_key(f): self.force_N[f][k].astype(np.float32) for f in FINGERS}
        return row | {
            PAIR_PLACE: self.place[k].astype(np.float32),
            PAIR_ERROR: np.array([self.error[k]], np.float32),
            PAIR_VELOCITY: self.velocity_m_s[k].astype(np.float32),
            PAIR_ACCELERATION: self.acceleration_m_s2[k].astype(np.float32),
            PAIR_GRIP: np.array([self.grip_N[k]], np.float32),
        }


def pair_features() -> dict[str, dict]:
    """Return LeRobot's features dict of recorded pairs."""

    def column(size: int, dtype: str = "float32", names: list[str] | None = None) -> dict[str, Any]:
        return {"dtype": dtype, "shape": (size,), "names": names}

    video = {"dtype": "video", "shape": MARKER_VIDEO_SHAPE, "names": ["height", "width", "channels"]}
    features: dict[str, dict] = {key: dict(video) for key in TACTILE_KEYS}
    features |= {pair_force_key(f): column(3, names=["fx_N", "fy_N", "fz_N"]) for f in FINGERS}
    features |= {sensor_key(f): column(1, "int64") for f in FINGERS}
    features |= {key: column(3, names=["x", "y", "z"]) for key in (PAIR_VELOCITY, PAIR_ACCELERATION)}
    features[PAIR_PLACE] = column(2, names=["x", "y"])
    features |= {key: column(1) for key in (PAIR_ERROR, PAIR_GRIP)}
    return features | {key: column(1, "int64") for key in (PAIR_INDENTER, PAIR_SESSION)}


class PairStore:
    """Appends chunks, or goes on with what is at ``root``.

    Args:
        root: folder; ``lerobot/`` and ``uniforce_pairs/`` below it.
        left_sensor, right_sensor: registry names.
        indenters: names, in the order of their indices.
        rate_hz: frames per second, a whole number.
        verify: how a dataset to go on with is checked, see ``check_dataset``.

    Raises:
        DatasetError: another recorder writes here, or other sensors, rates or features are there.
    """

    def __init__(
        self,
        root: str | Path,
        left_sensor: str,
        right_sensor: str,
        indenters: tuple[str, ...],
        rate_hz: int,
        verify: str = "quick",
    ) -> None:
        self.root = Path(root)
        self.indenters = indenters
        # the layout tells left from right by folder names, which two sensors of one kind would share
        same = left_sensor == right_sensor
        self.names = (f"{left_sensor}_l", f"{right_sensor}_r") if same else (left_sensor, right_sensor)
        self._recorder = EpisodeRecorder(
            self.root / DATASET,
            "local/uniforce_pairs",
            left_sensor,
            right_sensor,
            rate_hz,
            features=pair_features(),
        )
        self.counts = np.zeros(len(indenters), int)
        self.coverage = [Coverage.empty() for _ in indenters]
        self.next_session = 0
        self._go_on(verify)

    @property
    def layout(self) -> Path:
        """Folder of the UniForce-pair layout."""
        return self.root / LAYOUT

    @property
    def dataset(self) -> Path:
        """Folder of the LeRobot dataset."""
        return self.root / DATASET

    def add(self, chunk: PairChunk) -> None:
        """Store a chunk durably.

        Raises:
            ContractError: an indenter nobody named, or fewer than two pairs.
            DatasetError: the disk is full, or a frame could not be stored; what was saved before is intact.
        """
        if not 0 <= chunk.indenter < len(self.indenters) or len(chunk) < MIN_CHUNK:
            came = f"indenter {chunk.indenter}, {len(chunk)} pairs"
            wanted = f"one of {len(self.indenters)} indenters and ≥ {MIN_CHUNK} pairs"
            raise ContractError(expected("chunk", wanted, came, "Collect more before saving."))
        for row in chunk.rows():
            self._recorder.add(row, f"hold the {self.indenters[chunk.indenter]}")
        self._recorder.save(success=True, outcome="success", seed=0)  # a pair dataset has no such columns
        self._count(chunk.indenter, (chunk.force_N["left"] + chunk.force_N["right"]) / 2, chunk.place)
        self.next_session = max(self.next_session, chunk.session + 1)
        self._write_layout(chunk.indenter, chunk.session, chunk.references, chunk.images)

    def close(self) -> None:
        """Let others write here."""
        self._recorder.close()

    def __enter__(self) -> PairStore:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _count(self, indenter: int, force_N: np.ndarray, place: np.ndarray) -> None:
        self.counts[indenter] += len(force_N)
        self.coverage[indenter].add(force_N, place)

    # --- going on ----------------------------------------------------------------------------------------------------

    def _go_on(self, verify: str) -> None:
        """Count what is there and bring the layout up to it."""
        if not self._recorder.num_episodes:
            return
        source = check_dataset(self.dataset, verify)
        forces = tuple(pair_force_key(f) for f in FINGERS)
        columns = source.columns((PAIR_INDENTER, PAIR_SESSION, PAIR_PLACE, *forces))
        indenter, session = (columns[key].reshape(-1) for key in (PAIR_INDENTER, PAIR_SESSION))
        if indenter.max() >= len(self.indenters):
            came = f"indenter {indenter.max()}"
            do = "Give the same indenters as before."
            raise DatasetError(expected(str(self.root), f"{len(self.indenters)} indenters", came, do))
        force_N = (columns[forces[0]] + columns[forces[1]]) / 2
        for index in np.unique(indenter):
            self._count(int(index), force_N[indenter == index], columns[PAIR_PLACE][indenter == index])
        self.next_session = int(session.max()) + 1
        for place in sorted(set(zip(indenter.tolist(), session.tolist(), strict=True))):
            self._catch_up(source, *place, rows=(indenter == place[0]) & (session == place[1]))

    def _catch_up(self, source: Source, indenter: int, session: int, rows: np.ndarray) -> None:
        """Write the layout's images that a kill left out; drop those the dataset does not know."""
        stored = [sorted(self._folder(indenter, session, f).glob("[0-9]*.jpg")) for f in FINGERS]
        have = min(int(rows.sum()), *map(len, stored))
        for image in (image for images in stored for image in images[have:]):
            image.unlink()
        seen = 0
        for episode in source.episodes:
            if not rows[episode.start]:
                continue
            if seen + episode.length > have:
                self._write_episode(source, episode, indenter, session, max(have - seen, 0))
            seen += episode.length

    def _write_episode(
        self, source: Source, episode: Episode, indenter: int, session: int, skip: int
    ) -> None:
        def frames(finger: Finger, reference: bool, count: int) -> np.ndarray:
            span = episode.videos[tactile_key(finger, reference)]
            return np.stack([image[..., 0] for image in episode_frames(span, count, source.fps)])

        references = {f: frames(f, True, 1)[0] for f in FINGERS}
        images = {f: frames(f, False, episode.length)[skip:] for f in FINGERS}
        self._write_layout(indenter, session, references, images)

    def _write_layout(
        self,
        indenter: int,
        session: int,
        references: dict[Finger, np.ndarray],
        images: dict[Finger, np.ndarray],
    ) -> None:
        recording = PairRecording(
            sensors=self.names,
            indenter=self.indenters[indenter],
            name="",
            left_reference=references["left"],
            right_reference=references["right"],
            left_frames=images["left"],
            right_frames=images["right"],
        )
        write_uniforce_pairs(self.layout, recording, PATTERN, self._date(session))

    def _date(self, session: int) -> str:
        """The layout's second level: a new session has new references, which may not share a folder."""
        return f"session_{session:03d}"

    def _folder(self, indenter: int, session: int, finger: Finger) -> Path:
        pairs = self.layout / PATTERN / self._date(session) / "_".join(self.names)
        return pairs / "marker" / self.names[FINGERS.index(finger)] / self.indenters[indenter]
