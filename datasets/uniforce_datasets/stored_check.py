"""Look at what was written before it counts as saved: every frame there, marker images bit by bit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from uniforce_datasets.content import end_frames
from uniforce_datasets.raw_video import FOLDER
from uniforce_datasets.source import VideoSpan, stored_frames
from uniforce_vtla.errors import DatasetError, expected

DO = "Episode discarded; record it again."


def check_stored(staged: Path, frames: int, fps: int, ends: Mapping[str, tuple[np.ndarray, ...]]) -> None:
    """Check the videos of one staged episode.

    Args:
        staged: staging folder with exactly one episode in it.
        frames: its length.
        fps: frames per second.
        ends: first and last recorded (H, W, 3) image by marker key.

    Raises:
        DatasetError: a frame is missing, or a decoded marker image differs from the recorded one.
    """
    for file in sorted((staged / FOLDER).rglob("*.mp4")):
        _check_whole(file, f"raw {file.parts[-2]}", frames)
    for file in sorted((staged / "videos").rglob("*.mp4")):
        key = file.parts[-3]
        _check_whole(file, key, frames)
        if key in ends and not _same_ends(file, frames, fps, ends[key]):
            raise DatasetError(expected(key, "the recorded marker images after decoding", "others", DO))


def _check_whole(file: Path, key: str, frames: int) -> None:
    stored = stored_frames(file)
    if stored != frames:
        raise DatasetError(expected(key, f"{frames} frames", stored, DO))


def _same_ends(file: Path, frames: int, fps: int, ends: tuple[np.ndarray, ...]) -> bool:
    decoded = end_frames(VideoSpan(file, 0.0), frames, fps)
    return all(np.array_equal(a, b) for a, b in zip(decoded, ends, strict=True))
