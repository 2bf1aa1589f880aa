"""Check a dataset's content: exact marker images, references that don't change, frames, numbers.

``check_stored`` is called before an episode counts as saved, ``check_content`` before a dataset is
read.
"""

import os
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from uniforce_datasets.hashes import Verify
from uniforce_datasets.raw_video import FOLDER, raw_path
from uniforce_datasets.source import Episode, Source, VideoSpan, episode_frames, stored_frames
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import ACTION, TACTILE_KEYS, tactile_key

COUNTED = ("episode_index", "frame_index", "timestamp")
OBSERVATION = "observation."
REFERENCE_KEYS = tuple(tactile_key(finger, reference=True) for finger in FINGERS)
TOLERANCE_s = 1e-4  # of a frame's time; LeRobot's own
END_FRAMES = 2  # frames looked at from the end of a video
BAR_AFTER_s = 5.0


def check_content(source: Source, verify: Verify = "full") -> None:
    """Check columns, frame counts and marker images.

    Args:
        source: an opened dataset.
        verify: "full" decodes every frame of every video; "quick" one frame of each finger's
            marker video and two of its reference in every episode; "off" does nothing.

    Raises DatasetError: NaN, a wrong time or count, a marker image with loss or colour, a
    reference that changes, a video that can't be decoded; names the episode.
    """
    if verify == "off":
        return
    _check_columns(source)
    check = partial(_decode if verify == "full" else _sample, source)
    bar = tqdm(
        total=len(source.episodes), desc="verify", unit="episode", delay=BAR_AFTER_s, leave=False
    )
    with bar, ThreadPoolExecutor(os.cpu_count()) as pool:
        for _ in pool.map(check, source.episodes):
            bar.update()
    _check_counts(source)


def check_stored(
    staged: Path, frames: int, fps: int, ends: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> None:
    """Check the videos of one staged episode.

    Args:
        staged: staging folder with exactly one episode in it.
        frames: its length.
        fps: frames per second.
        ends: first and last recorded (H, W, 3) image by marker key.

    Raises DatasetError: a frame is missing, or a decoded marker image isn't the recorded one.
    """
    do = "Episode discarded; record it again."
    videos = {}
    for file in sorted((staged / FOLDER).rglob("*.mp4")):
        videos[file] = f"raw {file.parts[-2]}"
    for file in sorted((staged / "videos").rglob("*.mp4")):
        videos[file] = file.parts[-3]
    for file, key in videos.items():
        stored = stored_frames(file)
        if stored != frames:
            raise DatasetError(expected(key, f"{frames} frames", stored, do))
        if key in ends:
            decoded = end_frames(VideoSpan(file, 0.0), frames, fps)
            if not np.array_equal(decoded, ends[key]):
                wanted = "the recorded marker images after decoding"
                raise DatasetError(expected(key, wanted, "others", do))


def end_frames(span: VideoSpan, length: int, fps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the last (H, W, 3) frame of an episode's video."""
    first = next(episode_frames(span, length, fps))
    *_, last = episode_frames(span, length, fps, first=max(0, length - END_FRAMES))
    return first, last


def _check_columns(source: Source) -> None:
    kept = source.columns((*COUNTED, *_numbers(source)))
    if any(kept[key].ndim > 1 for key in COUNTED):
        do = "Restore it from a copy."
        raise DatasetError(
            expected(str(source.root / "data"), f"one number each in {COUNTED}", "rows", do)
        )
    indices = []
    frames = []
    for episode in source.episodes:
        indices.append(np.full(episode.length, episode.index))
        frames.append(np.arange(episode.length))
    index = np.concatenate(indices)
    frame = np.concatenate(frames)
    late_s = np.abs(kept.pop("timestamp") - frame / float(source.info["fps"]))
    # column, what it should hold, rows that don't
    rules = [
        ("episode_index", "the number of its episode", kept.pop("episode_index") != index),
        ("frame_index", "0, 1, 2, … in an episode", kept.pop("frame_index") != frame),
        ("timestamp", "frame_index / fps", ~(late_s <= TOLERANCE_s)),
    ]
    for key, rows in kept.items():
        is_finite = np.isfinite(rows).reshape(len(rows), -1).all(axis=1)
        rules.append((key, "finite numbers", ~is_finite))
    for key, wanted, wrong in rules:
        if wrong.any():
            row = int(wrong.argmax())
            where = f"{key} in {source.root / 'data'}, episode {index[row]}"
            came = f"another in frame {frame[row]}"
            raise DatasetError(expected(where, wanted, came, "Restore it from a copy."))


def _numbers(source: Source) -> list[str]:
    """Return the columns of numbers that a policy reads or learns."""
    found = []
    for key, feature in source.features.items():
        is_vector = feature["dtype"] in ("float32", "float64") and len(feature["shape"]) == 1
        if is_vector and (key == ACTION or key.startswith(OBSERVATION)):
            found.append(key)
    return found


def _check_counts(source: Source) -> None:
    """Compare the frame counts in the videos' headers with the lengths of their episodes."""
    episodes_of: dict[Path, list[Episode]] = defaultdict(list)
    for episode in source.episodes:
        for span in episode.videos.values():
            episodes_of[span.file].append(episode)
        for finger in FINGERS:
            raw = raw_path(source.root, finger, episode.index)
            if raw.is_file():
                episodes_of[raw].append(episode)
    for file, episodes in episodes_of.items():
        stored = stored_frames(file)
        wanted = sum(episode.length for episode in episodes)
        if stored != wanted:
            where = f"{file}, episode {', '.join(str(episode.index) for episode in episodes[:3])}"
            do = "Frames are missing or too many: restore it from a copy."
            raise DatasetError(expected(where, f"{wanted} frames", stored, do))


def _sample(source: Source, episode: Episode) -> None:
    """Check the middle of marker videos and both ends of references."""
    for key in TACTILE_KEYS:
        if key not in episode.videos:
            continue
        span = episode.videos[key]
        frames: Iterable[np.ndarray]
        with _named(episode):
            if key in REFERENCE_KEYS:
                frames = end_frames(span, episode.length, source.fps)
            else:
                middle = episode.length // 2
                frames = [next(episode_frames(span, episode.length, source.fps, first=middle))]
        _check_markers(episode, key, frames)


def _decode(source: Source, episode: Episode) -> None:
    """Check every frame of every video, raw ones too."""
    for key, span in episode.videos.items():
        frames = _whole(source, episode, span)
        if key in TACTILE_KEYS:
            _check_markers(episode, key, frames)
        deque(frames, maxlen=0)
    for finger in FINGERS:
        file = raw_path(source.root, finger, episode.index)
        if file.is_file():
            deque(_whole(source, episode, VideoSpan(file, 0.0)), maxlen=0)


def _whole(source: Source, episode: Episode, span: VideoSpan) -> Iterator[np.ndarray]:
    with _named(episode):
        yield from episode_frames(span, episode.length, source.fps)


def _check_markers(episode: Episode, key: str, frames: Iterable[np.ndarray]) -> None:
    """Raise DatasetError unless the (H, W, 3) frames hold only 0 and 255, R = G = B."""
    where = f"{key} in {episode.videos[key].file}, episode {episode.index}"
    last = None
    for frame in frames:
        if last is not None and np.array_equal(frame, last):
            continue
        if last is not None and key in REFERENCE_KEYS:
            do = "A reference is taken once, before an episode: "
            do += "record it again, or leave the episode out."
            raise DatasetError(expected(where, "one image all the time", "another one", do))
        between = bool((frame + np.uint8(1) > 1).any())  # 255 + 1 is 0
        if between or not (frame[..., 1:] == frame[..., :1]).all():
            came = "values between" if between else "colours"
            do = "The video was encoded with loss: "
            do += "record or convert it again with h264 crf 0 (uniforce record does)."
            raise DatasetError(expected(where, "only 0 and 255 after decoding", came, do))
        last = frame


@contextmanager
def _named(episode: Episode) -> Iterator[None]:
    """Say in an error which episode it is about."""
    try:
        yield
    except DatasetError as error:
        raise DatasetError(f"episode {episode.index}: {error}") from error
