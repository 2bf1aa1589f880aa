"""Gather one recorded episode's story: pictures at telling moments, felt forces, latents, verdict."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uniforce_cli.raw_recording import raw_touch
from uniforce_cli.recording_forces import EpisodeForces, RecordingForces, latent_change, marker_images
from uniforce_datasets.source import Episode, Source, episode_frames
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.evaluation.episode_summary import EpisodeSummary, KeyFrame, find_key_frames
from uniforce_vtla.evaluation.finger_estimates import FingerEstimate
from uniforce_vtla.keys import TACTILE_KEYS
from uniforce_vtla.markers.overlay import overlay
from uniforce_vtla.tokenizer import Tokenizer

FILM = 12  # pictures in a film strip: square ones fill a line of it
UNKNOWN_FRICTION = (np.inf, np.inf)  # no pad ever reaches its limit: slippage isn't judged
IMAGES = "observation.images."


def cameras(source: Source) -> dict[str, str]:
    """Return key by name of every recorded video that is no marker image: the scene cameras."""
    videos = [key for key, feature in source.features.items() if feature["dtype"] == "video"]
    return {key.removeprefix(IMAGES): key for key in videos if key not in TACTILE_KEYS}


def tell(
    recording: RecordingForces,
    tokenizer: Tokenizer,
    episode: Episode,
    friction: tuple[float, float] | None,
    title: str,
) -> EpisodeSummary:
    """Return the story of an episode.

    Raises:
        DatasetError: a video that is missing or truncated.
    """
    felt = recording.feel(episode)
    found, truth, note = _judged(felt, friction or UNKNOWN_FRICTION)
    named = find_key_frames(felt.force_N, felt.tool_z_m)
    film = ((np.arange(FILM) + 0.5) / FILM * episode.length).astype(int).tolist()  # middle of each picture
    source, telling = recording.source, set(named.values())
    seen = {
        name: dict(_chosen(camera_frames(source, episode, key), telling.union(film)))
        for name, key in cameras(source).items()
    }
    touched = {finger: _overlays(source, episode, finger, telling) for finger in FINGERS}
    kept = {finger: read for finger in FINGERS if (read := raw_touch(source, episode, finger))}
    raw = {finger: dict(_chosen(read(), telling)) for finger, read in kept.items()}
    key_frames = tuple(
        KeyFrame(
            name,
            frame,
            {camera: pictures[frame] for camera, pictures in seen.items()},
            {finger: pictures[frame] for finger, pictures in touched.items()},
            {finger: pictures[frame] for finger, pictures in raw.items()},
        )
        for name, frame in named.items()
    )
    return EpisodeSummary(
        title=title,
        time_s=felt.time_s,
        films={camera: [pictures[frame] for frame in film] for camera, pictures in seen.items()},
        force_N=felt.force_N,
        true_force_N=felt.true_force_N,
        change={f: latent_change(tokenizer, source, episode, f) for f in FINGERS},
        key_frames=key_frames,
        found=found,
        truth=truth,
        judges_slip=friction is not None,
        note=note,
    )


def _judged(
    felt: EpisodeForces, friction: tuple[float, float]
) -> tuple[FingerEstimate | None, FingerEstimate | None, str]:
    try:
        return *felt.judge(friction), ""
    except DatasetError as error:  # an episode nobody can judge can still be looked at; the sheet says why
        return None, None, str(error)


def camera_frames(source: Source, episode: Episode, key: str) -> Iterator[np.ndarray]:
    """Return an episode's frames of a video key, (H, W, 3) uint8 RGB; raise DatasetError where they are truncated."""
    return episode_frames(episode.videos[key], episode.length, source.fps)


def _chosen(frames: Iterator[np.ndarray], wanted: set[int]) -> Iterator[tuple[int, np.ndarray]]:
    return ((number, frame) for number, frame in enumerate(frames) if number in wanted)


def _overlays(source: Source, episode: Episode, finger: Finger, wanted: set[int]) -> dict[int, np.ndarray]:
    reference, current = marker_images(source, episode, finger)
    return {n: overlay(reference, image) for n, image in _chosen(current(), wanted)}
