"""Check a dataset's content whatever its hashes say: exact marker images, resting references, every frame, numbers.

Looked at before an episode counts as saved (``check_stored``), and again before a dataset is read (``check_content``).
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from uniforce_datasets.dataset_info import videos
from uniforce_datasets.hashes import Verify
from uniforce_datasets.raw_video import FOLDER, raw_path
from uniforce_datasets.source import Episode, Source, VideoSpan, episode_frames, stored_frames
from uniforce_datasets.video_encoder import REFERENCE_KEYS
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import ACTION, TACTILE_KEYS

COUNTED = ("episode_index", "frame_index", "timestamp")
OBSERVATION = "observation."
TOLERANCE_s = 1e-4  # of a frame's time; LeRobot's own
END_FRAMES = 2  # frames looked at from the end of a video
BAR_AFTER_s = 5.0


def check_content(source: Source, verify: Verify = "full") -> None:
    """Check columns, frame counts and marker images.

    Args:
        source: an opened dataset.
        verify: "full" decodes every frame of every video; "quick" one frame of each finger's marker video and two of
            its reference in every episode; "off" does nothing.

    Raises DatasetError: NaN, a wrong time or count, a marker image with loss or colour, a reference that changes, a
    video that can't be decoded; names the episode.
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
    staged: Path, frames: int, fps: int, ends: Mapping[str, tuple[np.ndarray, ...]]
) -> None:
    """Check the videos of one staged episode.

    Args:
        staged: staging folder with exactly one episode in it.
        frames: its length.
        fps: frames per second.
        ends: first and last recorded (H, W, 3) image by marker key.

    Raises DatasetError: a frame is missing, or a decoded marker image differs from the recorded one.
    """
    do = "Episode discarded; record it again."
    raw = {file: f"raw {file.parts[-2]}" for file in sorted((staged / FOLDER).rglob("*.mp4"))}
    videos = {file: file.parts[-3] for file in sorted((staged / "videos").rglob("*.mp4"))}
    for file, key in (raw | videos).items():
        stored = stored_frames(file)
        if stored != frames:
            raise DatasetError(expected(key, f"{frames} frames", stored, do))
        decoded = end_frames(VideoSpan(file, 0.0), frames, fps) if key in ends else ()
        if not all(np.array_equal(a, b) for a, b in zip(decoded, ends.get(key, ()), strict=True)):
            raise DatasetError(
                expected(key, "the recorded marker images after decoding", "others", do)
            )


def end_frames(span: VideoSpan, length: int, fps: int) -> tuple[np.ndarray, ...]:
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
    lengths = [episode.length for episode in source.episodes]
    indices = np.repeat([episode.index for episode in source.episodes], lengths)
    frames = np.concatenate([np.arange(length) for length in lengths])
    episode, frame, time_s = (kept.pop(key) for key in COUNTED)
    late_s = np.abs(time_s - frames / float(source.info["fps"]))
    wrong = {
        ("episode_index", "the number of its episode"): episode != indices,
        ("frame_index", "0, 1, 2, … in an episode"): frame != frames,
        ("timestamp", "frame_index / fps"): ~(late_s <= TOLERANCE_s),
    }
    for key, rows in kept.items():
        wrong[key, "finite numbers"] = ~np.isfinite(rows).reshape(len(rows), -1).all(axis=1)
    for (key, wanted), rows in wrong.items():
        if rows.any():
            row = int(rows.argmax())
            where = f"{key} in {source.root / 'data'}, episode {indices[row]}"
            raise DatasetError(
                expected(
                    where, wanted, f"another in frame {frames[row]}", "Restore it from a copy."
                )
            )


def _numbers(source: Source) -> list[str]:
    """Return the columns of numbers that a policy reads or learns."""
    kinds = {key: (f["dtype"], len(f["shape"])) for key, f in source.features.items()}
    return [
        key
        for key, kind in kinds.items()
        if kind in (("float32", 1), ("float64", 1))
        and (key.startswith(OBSERVATION) or key == ACTION)
    ]


def _check_counts(source: Source) -> None:
    """Compare what video files announce with the lengths of the episodes in them."""
    needed: dict[Path, list[Episode]] = {}
    for episode in source.episodes:
        raw = [raw_path(source.root, finger, episode.index) for finger in FINGERS]
        for file in [
            *(span.file for span in episode.videos.values()),
            *(r for r in raw if r.is_file()),
        ]:
            needed.setdefault(file, []).append(episode)
    for file, episodes in needed.items():
        stored, wanted = stored_frames(file), sum(episode.length for episode in episodes)
        if stored != wanted:
            where = f"{file}, episode {', '.join(str(episode.index) for episode in episodes[:3])}"
            do = "Frames are missing or too many: restore it from a copy."
            raise DatasetError(expected(where, f"{wanted} frames", stored, do))


def _sample(source: Source, episode: Episode) -> None:
    """Look at the middle of marker videos and at both ends of references."""
    for key in (key for key in videos(source.info) if key in TACTILE_KEYS):
        span, length, middle = episode.videos[key], episode.length, episode.length // 2
        with _named(episode):
            if key in REFERENCE_KEYS:
                frames = end_frames(span, length, source.fps)
            else:
                frames = (next(episode_frames(span, length, source.fps, first=middle)),)
        _check_markers(episode, key, frames)


def _decode(source: Source, episode: Episode) -> None:
    """Look at every frame of every video, raw ones too."""
    for key in videos(source.info):
        frames = _whole(source, episode, episode.videos[key])
        if key in TACTILE_KEYS:
            _check_markers(episode, key, frames)
        else:
            sum(1 for _ in frames)
    for finger in FINGERS:
        file = raw_path(source.root, finger, episode.index)
        if file.is_file():
            sum(1 for _ in _whole(source, episode, VideoSpan(file, 0.0)))


def _whole(source: Source, episode: Episode, span: VideoSpan) -> Iterator[np.ndarray]:
    with _named(episode):
        yield from episode_frames(span, episode.length, source.fps)


def _check_markers(episode: Episode, key: str, frames: Iterable[np.ndarray]) -> None:
    rest = None
    for frame in frames:
        if rest is not None and np.array_equal(frame, rest):
            continue
        if rest is not None and key in REFERENCE_KEYS:
            do = "A reference is taken once, before an episode: record it again, or leave the episode out."
            raise DatasetError(
                expected(_place(episode, key), "one image all the time", "another one", do)
            )
        _check_marker(episode, key, frame)
        rest = frame


def _check_marker(episode: Episode, key: str, frame: np.ndarray) -> None:
    """Raise DatasetError unless a decoded (H, W, 3) frame holds only 0 and 255, R = G = B."""
    between = bool((frame + np.uint8(1) > 1).any())  # 255 + 1 is 0
    if between or not (frame[..., 1:] == frame[..., :1]).all():
        came = "values between" if between else "colours"
        do = "The video was encoded with loss: record or convert it again with h264 crf 0 (uniforce record does)."
        raise DatasetError(
            expected(_place(episode, key), "only 0 and 255 after decoding", came, do)
        )


def _place(episode: Episode, key: str) -> str:
    return f"{key} in {episode.videos[key].file}, episode {episode.index}"


@contextmanager
def _named(episode: Episode) -> Iterator[None]:
    """Say in an error which episode it is about."""
    try:
        yield
    except DatasetError as error:
        raise DatasetError(f"episode {episode.index}: {error}") from error
