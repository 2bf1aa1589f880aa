"""What a recorded finger's sensor gave before any canonicaliser: camera frames, or taxel counts as a picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from uniforce_cli.touch_view import counts_picture
from uniforce_datasets.raw_video import raw_path
from uniforce_datasets.source import Episode, Source, VideoSpan, episode_frames
from uniforce_vtla.contracts import TAXEL_SHAPE, Finger
from uniforce_vtla.keys import counts_key


def raw_touch(source: Source, episode: Episode, finger: Finger) -> Callable[[], Iterator[np.ndarray]] | None:
    """Return what reads an episode's raw frames, (H, W, 3) uint8 RGB each; None where none were kept.

    Taxels are drawn as the change of their normal counts since the episode's first frame, which is in free air.

    Raises:
        DatasetError: (when read) frames that are missing or truncated.
    """
    if counts_key(finger) in source.features:
        counts = source.columns((counts_key(finger),))[counts_key(finger)]
        rows = counts[episode.start : episode.start + episode.length].astype(np.int64)
        change = (rows - rows[0]).reshape(episode.length, *TAXEL_SHAPE)
        return lambda: map(counts_picture, change)
    file = raw_path(source.root, finger, episode.index)
    if not file.is_file():
        return None
    return lambda: episode_frames(VideoSpan(file, 0.0), episode.length, source.fps)
