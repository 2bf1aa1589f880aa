"""Record demonstrations as a LeRobot v3 dataset that survives anything but the loss of the disk."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from lerobot.datasets.dataset_writer import DatasetWriter
from lerobot.datasets.io_utils import write_info

from datasets import disable_progress_bars
from uniforce_datasets.cards import write_card
from uniforce_datasets.content import check_stored
from uniforce_datasets.dataset_info import INFO
from uniforce_datasets.features import (
    CAMERA_SHAPE,
    ColumnMaker,
    Shape,
    check_row,
    dataset_features,
    refuse_other_features,
    sensor_index,
)
from uniforce_datasets.hashes import check_hashes, stage_hashes
from uniforce_datasets.pooled_quantiles import write_pooled_stats
from uniforce_datasets.raw_video import RawVideo
from uniforce_datasets.rig_settings import Settings, write_settings
from uniforce_datasets.staged_writer import open_writer
from uniforce_datasets.staging import STAGING, claim, commit, lock, recover
from uniforce_datasets.video_encoder import PerKeyEncoder, codec_of
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import (
    DatasetError,
    DroppedFrameError,
    expected,
    not_stored,
    require_one_of,
)
from uniforce_vtla.keys import (
    ABORT_CAUSES,
    CAUSE,
    OUTCOME,
    OUTCOME_NAMES,
    SEED,
    SUCCESS,
    TACTILE_KEYS,
    sensor_key,
)

MIN_FRAMES = 2  # LeRobot computes no video statistics for fewer
AT_THE_END = (SUCCESS, OUTCOME, SEED, CAUSE)


class EpisodeRecorder:
    """Creates a dataset, or goes on with the one at ``root``.

    Args:
        root: the dataset's folder.
        repo_id: LeRobot's name for it; nothing is ever uploaded or downloaded.
        left_sensor: registry name of the sensor on the left finger.
        right_sensor: registry name of the sensor on the right finger.
        fps: observations per second.
        cameras: (rows, columns, 3) by scene camera, or one shape for the two usual ones.
        truth: whether the true pad wrench is stored (simulation).
        realtime: True on hardware: a video frame that can't be stored in time fails the episode.
        queue_frames: video frames that may wait per key.
        further: features of columns a robot stores beside the usual ones.
        raw_shapes: shape of the raw tactile frames to keep beside the dataset, by finger.
        lock_wait_s: how long to wait for another recorder that is about to end.
        features: columns of another kind of recording, in place of a demonstration's (``truth`` and
            ``cameras`` then say nothing); marker images are stored exactly there too.

    Raises DatasetError: another recorder writes here, the folder can't be written, holds something
    else or other features, a file that isn't as it was saved, the disk is full, a video frame was
    lost; ContractError: a frame with a missing key, a wrong shape, or a marker image that isn't
    {0, 255}.
    """

    def __init__(
        self,
        root: str | Path,
        repo_id: str,
        left_sensor: str,
        right_sensor: str,
        fps: int = 30,
        cameras: Shape | Mapping[str, Shape] = CAMERA_SHAPE,
        truth: bool = True,
        realtime: bool = False,
        queue_frames: int = 30,
        further: Mapping[str, dict[str, Any]] | None = None,
        raw_shapes: Mapping[Finger, tuple[int, ...]] | None = None,
        lock_wait_s: float = 0.0,
        features: dict[str, dict] | None = None,
    ) -> None:
        # LeRobot's own, one per saved episode: they tear other lines, and fail with stderr
        disable_progress_bars()
        self.root = claim(root)
        self._repo_id = repo_id
        self._fps = fps
        self._realtime = realtime
        self._queue_frames = queue_frames
        self._sensors = {
            sensor_key("left"): np.array([sensor_index(left_sensor)], dtype=np.int64),
            sensor_key("right"): np.array([sensor_index(right_sensor)], dtype=np.int64),
        }
        if features is None:
            features = dataset_features(cameras, truth, further)
        self._features = features
        # columns known only when the episode is over
        self._at_the_end = [key for key in AT_THE_END if key in features]
        self._columns = ColumnMaker()
        self._raw_shapes = dict(raw_shapes or {})
        self._lock = lock(self.root, lock_wait_s)
        self._writer: DatasetWriter | None = None  # of the running episode
        self._stored_episodes = 0
        self._stored_frames = 0
        with ExitStack() as failed:
            failed.callback(self._lock.release)
            with self._storing("a dataset to go on with"):
                recover(self.root)
                if (self.root / INFO).exists():
                    check_hashes(self.root, "quick")
                self._open()
            failed.pop_all()

    @property
    def num_episodes(self) -> int:
        """Saved episodes, those of earlier sessions included."""
        return self._stored_episodes

    @property
    def total_frames(self) -> int:
        """Frames of all saved episodes."""
        return self._stored_frames

    @property
    def features(self) -> dict[str, dict]:
        """LeRobot's features dict of what is recorded."""
        return dict(self._features)

    @property
    def num_frames(self) -> int:
        """Frames waiting in the current episode."""
        if self._writer is None:
            return 0
        return self._writer.episode_buffer["size"]

    def add(
        self, frame: Mapping[str, Any], task: str, raw: Mapping[Finger, np.ndarray] | None = None
    ) -> None:
        """Append one observation and the action commanded at it; every array is copied.

        Args:
            frame: every column but provenance that the recorder knows: cameras (H, W, 3) uint8,
                marker images (480, 640) or (480, 640, 3) uint8, state, action, truth, capture time
                and age.
            task: the instruction, in words.
            raw: raw frame (H, W, 3) uint8 by finger, exactly those announced.
        """
        row = {key: self._columns(key, value) for key, value in frame.items()} | self._sensors
        for key in self._at_the_end:
            row[key] = np.zeros(1, dtype=self._features[key]["dtype"])
        check_row(row, self._features)
        with self._storing("room to store it"):
            writer = self._writer
            if writer is None:
                writer = self._open()
            self._raw.add(raw or {})
            writer.add_frame(row | {"task": task})
        for key in TACTILE_KEYS:
            first, _ = self._ends.get(key, (row[key], row[key]))
            self._ends[key] = (first, row[key])
        self._refuse_dropped()

    def save(
        self,
        success: bool,
        outcome: str,
        seed: int,
        cause: str = "none",
        card: Mapping[str, Any] | None = None,
        settings: Settings | None = None,
    ) -> None:
        """Make the episode durable; on any error discard it and leave the saved ones as they are.

        Args:
            success: clean success.
            outcome: one of ``keys.OUTCOME_NAMES``.
            seed: the integer that rebuilds the scene.
            cause: one of ``keys.ABORT_CAUSES``, stored where the dataset has the column.
            card: further facts of the episode, kept as ``cards/episode_000017.json``.
            settings: of the rig, see ``rig_settings``; compare them before the first episode.
        """
        require_one_of("outcome", outcome, OUTCOME_NAMES, "Take evaluation's outcome.")
        require_one_of("cause", cause, ABORT_CAUSES)
        writer = self._writer
        frames = self.num_frames
        episode = self.num_episodes
        if writer is None or frames < MIN_FRAMES:
            self.discard()
            raise DatasetError(
                expected("episode", f"≥ {MIN_FRAMES} frames", frames, "Record longer.")
            )
        self._refuse_dropped()
        ends = {
            SUCCESS: success,
            OUTCOME: OUTCOME_NAMES.index(outcome),
            SEED: seed,
            CAUSE: ABORT_CAUSES.index(cause),
        }
        for key in self._at_the_end:
            value = np.array([ends[key]], dtype=self._features[key]["dtype"])
            writer.episode_buffer[key] = [value] * frames
        try:
            with self._storing("room to store it"):
                writer.save_episode()
                self._raw.save(episode)
                write_card(self.root / STAGING, episode, card)
                write_settings(self.root, self.root / STAGING, episode, settings or {})
                _name_marker_codec(writer)
                writer.finalize()
                check_stored(self.root / STAGING, frames, self._fps, self._ends)
                stage_hashes(self.root, episode)
                commit(self.root)
            self._stored_episodes += 1
            self._stored_frames += frames
            self.discard()
        except DatasetError:
            with suppress(OSError, RuntimeError, DatasetError):
                self._open()  # which finishes what was interrupted on its way in
            if self.num_episodes == episode:
                raise

    def discard(self) -> None:
        """Let go of the running episode without writing: what it staged is deleted."""
        writer = self._writer
        self._writer = None
        if writer is not None:
            self._raw.cancel()
            writer.cancel_pending_videos()
            writer._meta._metadata_buffer.clear()
            with suppress(OSError, RuntimeError):  # a full disk, and all of it is deleted now
                writer.finalize()
        shutil.rmtree(self.root / STAGING, ignore_errors=True)

    def close(self) -> None:
        """Drop an unfinished episode, pool the statistics over all data, let others record here.

        Raises DatasetError: no room for the statistics, others can record nevertheless; see
        ``write_pooled_stats``.
        """
        if not self._lock.is_locked:
            return
        try:
            self.discard()
            with self._storing("room for the statistics of all episodes"):
                recover(self.root)
                if (self.root / INFO).exists():
                    write_pooled_stats(self.root)
        finally:
            self._lock.release()

    def __enter__(self) -> EpisodeRecorder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _open(self) -> DatasetWriter:
        """Finish an interrupted save; return a LeRobot writer into the staging folder."""
        recover(self.root)
        writer = open_writer(
            self.root, self._repo_id, self._fps, self._features, self._queue_frames, self._realtime
        )
        refuse_other_features(writer._meta, self._fps, self._features)
        encoder = PerKeyEncoder(self._fps, self._queue_frames, self._realtime)
        self._raw = RawVideo(self.root / STAGING, self._raw_shapes, encoder)
        # first and last marker images of the episode
        self._ends: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._stored_episodes = writer._meta.total_episodes
        self._stored_frames = int(writer._meta.total_frames)
        self._writer = writer
        return writer

    def _refuse_dropped(self) -> None:
        dropped = dict(self._raw.dropped)
        if self._writer is not None:
            dropped |= self._writer._streaming_encoder.dropped
        if dropped:
            self.discard()
            do = "Episode discarded; record it again."
            raise DroppedFrameError(
                expected("video", "every frame stored", f"{dropped} dropped", do)
            )

    @contextmanager
    def _storing(self, wanted: str) -> Iterator[None]:
        """Turn errors of storing into a DatasetError, with the running episode discarded."""
        try:
            yield
        except (OSError, RuntimeError, DatasetError) as error:
            self.discard()
            if isinstance(error, DatasetError):
                raise
            do = f"The running episode is dropped; {self.num_episodes} saved episodes are intact."
            raise not_stored(str(self.root), wanted, error, do) from error


def _name_marker_codec(writer: DatasetWriter) -> None:
    """Say crf 0 in info.json: LeRobot writes its one codec for every key, at the first episode."""
    meta = writer._meta
    if meta.total_episodes == 1:
        for key in TACTILE_KEYS:
            meta.update_video_info(key, video_encoder=codec_of(key))
        write_info(meta.info, meta.root)
