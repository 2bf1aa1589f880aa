"""Open a recorded dataset only if its touch can be trusted: whole files, references, lossless marker video."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from uniforce_datasets.source import Episode, Source, VideoSpan, episode_frames, read_source, stored_frames
from uniforce_datasets.staged_writer import LOCAL
from uniforce_vtla.contracts import check_marker_image
from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.keys import tactile_key

END_FRAMES = 2  # frames looked at from the end of a sampled episode


def open_dataset(root: str | Path, repo_id: str = "local/dataset", **options: Any) -> LeRobotDataset:
    """Return LeRobot's own dataset after checking what it doesn't check.

    Args:
        root: folder of the dataset.
        repo_id: LeRobot's name for it; the hub is never asked.
        options: passed on to ``LeRobotDataset``.

    Raises:
        DatasetError: a file is missing or truncated, a marker stream has no reference, marker video is lossy.
    """
    source = check_dataset(root)
    return LeRobotDataset(
        repo_id, **({"root": source.root, "revision": LOCAL, "video_backend": "pyav"} | options)
    )


def check_dataset(root: str | Path) -> Source:
    """Check a dataset as ``open_dataset`` does and return its source."""
    source = read_source(root)
    _check_references(source)
    source.columns(("episode_index",))
    _check_videos(source)
    for episode in {source.episodes[0], source.episodes[-1]} if source.fingers else ():
        for finger in source.fingers:
            check_lossless(source, episode, tactile_key(finger))
            check_lossless(source, episode, tactile_key(finger, reference=True))
    return source


def check_lossless(source: Source, episode: Episode, key: str) -> None:
    """Raise DatasetError unless the first and last frames of a marker video hold only 0 and 255, R = G = B."""
    first, last = end_frames(episode.videos[key], episode.length, source.fps)
    for frame in (first, last):
        try:
            check_marker_image(frame[..., 0], key)
            grey = bool((frame == frame[..., :1]).all())
        except ContractError as error:
            raise DatasetError(_lossy(episode, key, "values between")) from error
        if not grey:
            raise DatasetError(_lossy(episode, key, "colours"))


def _lossy(episode: Episode, key: str, came: str) -> str:
    do = "The video was encoded with loss: record or convert it again with h264 crf 0 (uniforce-record does)."
    return expected(f"{key}, episode {episode.index}", "only 0 and 255 after decoding", came, do)


def end_frames(span: VideoSpan, length: int, fps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the last (H, W, 3) frame of an episode's video."""
    first = next(episode_frames(span, length, fps))
    *_, last = episode_frames(span, length, fps, first=max(0, length - END_FRAMES))
    return first, last


def _check_references(source: Source) -> None:
    for finger in source.fingers:
        if tactile_key(finger, reference=True) not in source.features:
            came = f"{tactile_key(finger)} alone"
            do = "Touch is read against a free-air reference: record it again with uniforce-record."
            raise DatasetError(expected("dataset", tactile_key(finger, reference=True), came, do))


def _check_videos(source: Source) -> None:
    needed: dict[Path, int] = {}
    for episode in source.episodes:
        for span in episode.videos.values():
            needed[span.file] = needed.get(span.file, 0) + episode.length
    for file, frames in needed.items():
        stored = stored_frames(file)
        if stored < frames:
            do = "The video is truncated: restore it from a copy."
            raise DatasetError(expected(str(file), f"{frames} frames", stored, do))
