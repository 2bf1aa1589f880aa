"""One recorded episode for a page or a viewer: pictures at its key frames, raw touch, forces, latents, events."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from uniforce_cli.recording_forces import EpisodeForces, RecordingForces, latent_change, marker_images
from uniforce_cli.touch_view import counts_picture
from uniforce_datasets.raw_video import raw_path
from uniforce_datasets.source import Episode, Source, VideoSpan, episode_frames
from uniforce_vtla.contracts import FINGERS, TAXEL_SHAPE, Finger
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.evaluation.episode_summary import EpisodeSummary, KeyFrame, find_key_frames
from uniforce_vtla.evaluation.finger_estimates import FingerEstimate
from uniforce_vtla.keys import TACTILE_KEYS, counts_key
from uniforce_vtla.markers.overlay import overlay
from uniforce_vtla.tokenizer import Tokenizer

FILM = 12  # pictures in a film strip: square ones fill a line of it
UNKNOWN_FRICTION = (np.inf, np.inf)  # no pad ever reaches its limit: slippage isn't judged
IMAGES = "observation.images."


def cameras(source: Source) -> dict[str, str]:
    """Return key by name of every recorded video that is no marker image: the scene cameras."""
    videos = [key for key, feature in source.features.items() if feature["dtype"] == "video"]
    return {key.removeprefix(IMAGES): key for key in videos if key not in TACTILE_KEYS}


def summarise_episode(
    recording: RecordingForces,
    tokenizer: Tokenizer,
    episode: Episode,
    friction: tuple[float, float] | None,
    title: str,
) -> EpisodeSummary:
    """Return what a page or viewer shows of an episode.

    Raises:
        DatasetError: a video that is missing or truncated.
    """
    source, forces = recording.source, recording.read(episode)
    found, truth, note = _judged(forces, friction or UNKNOWN_FRICTION)
    named = find_key_frames(forces.force_N, forces.tool_z_m)
    film = ((np.arange(FILM) + 0.5) / FILM * episode.length).astype(int).tolist()  # middle of each picture
    shown = set(named.values())
    seen = {
        name: _chosen(camera_frames(source, episode, key), shown.union(film))
        for name, key in cameras(source).items()
    }
    markers = {finger: _overlays(source, episode, finger, shown) for finger in FINGERS}
    kept = {finger: read for finger in FINGERS if (read := raw_touch(source, episode, finger))}
    raw = {finger: _chosen(read(), shown) for finger, read in kept.items()}
    key_frames = tuple(
        KeyFrame(name, frame, *({key: p[frame] for key, p in kind.items()} for kind in (seen, markers, raw)))
        for name, frame in named.items()
    )
    return EpisodeSummary(
        title=title,
        time_s=forces.time_s,
        films={camera: [pictures[frame] for frame in film] for camera, pictures in seen.items()},
        force_N=forces.force_N,
        true_force_N=forces.true_force_N,
        change={f: latent_change(tokenizer, source, episode, f) for f in FINGERS},
        key_frames=key_frames,
        found=found,
        truth=truth,
        judges_slip=friction is not None,
        note=note,
    )


def _judged(
    forces: EpisodeForces, friction: tuple[float, float]
) -> tuple[FingerEstimate | None, FingerEstimate | None, str]:
    try:
        return *forces.judge(friction), ""
    except (
        DatasetError
    ) as error:  # an episode that can't be judged can still be looked at; the sheet says why
        return None, None, str(error)


def camera_frames(source: Source, episode: Episode, key: str) -> Iterator[np.ndarray]:
    """Return an episode's frames of a video key, (H, W, 3) uint8 RGB; raise DatasetError where they are truncated."""
    return episode_frames(episode.videos[key], episode.length, source.fps)


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


def _chosen(frames: Iterator[np.ndarray], wanted: set[int]) -> dict[int, np.ndarray]:
    return {number: frame for number, frame in enumerate(frames) if number in wanted}


def _overlays(source: Source, episode: Episode, finger: Finger, wanted: set[int]) -> dict[int, np.ndarray]:
    reference, current = marker_images(source, episode, finger)
    return {number: overlay(reference, image) for number, image in _chosen(current(), wanted).items()}
