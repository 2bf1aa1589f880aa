"""An episode's pictures, stream by stream, and some of them encoded for a page with a slider."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from uniforce_cli.recorded_episode import cameras, frames, raw_touch
from uniforce_datasets.source import Episode, Source, marker_images
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.evaluation.episode_summary import EpisodeSummary
from uniforce_vtla.markers.raster import overlay

MOMENTS = 120  # pictures of each stream on a page: 4 MB of them
WIDTH_PX = 320  # of the largest of them
QUALITY = 75  # of WebP, up to 100
HEAT_PX = 16  # a patch's side in a heat map, so that a viewer has something to show


@dataclass(frozen=True)
class Films:
    """Every stream at some frames of an episode."""

    frames: tuple[int, ...]  # their numbers, rising from 0
    pictures: dict[str, tuple[bytes, ...]]  # stream → one WebP picture for each of these frames


def streams(
    summary: EpisodeSummary, source: Source, episode: Episode
) -> Iterator[tuple[str, Iterator[np.ndarray]]]:
    """Yield the name of every stream of pictures, e.g. camera/front or latent/left, and its frames.

    Frames are (H, W, 3) uint8 RGB. Reading them raises DatasetError where a video is missing or
    truncated.
    """
    for name, key in cameras(source).items():
        yield f"camera/{name}", frames(source, episode, key)
    for finger in FINGERS:
        raw = raw_touch(source, episode, finger)
        if raw is not None:
            yield f"raw/{finger}", raw
        reference, current = marker_images(episode, source.fps, finger)
        yield f"markers/{finger}", map(partial(overlay, reference), current)
        strength = summary.strength(finger)
        yield f"latent/{finger}", map(_heat, strength * (255 / max(float(strength.max()), 1e-6)))


def read_films(summary: EpisodeSummary, source: Source, episode: Episode) -> Films:
    """Return pictures of evenly spaced frames and of key frames; DatasetError as ``streams``."""
    even = np.linspace(0, episode.length - 1, min(episode.length, MOMENTS)).round().astype(int)
    wanted = {*even.tolist(), *(moment.frame for moment in summary.key_frames)}
    pictures = {}
    for name, stream in streams(summary, source, episode):
        shown = [_small(frame) for number, frame in enumerate(stream) if number in wanted]
        pictures[name] = tuple(shown)
    return Films(tuple(sorted(wanted)), pictures)


def encoded(picture: np.ndarray, quality: int = QUALITY) -> bytes:
    """Return the bytes of a WebP file; ``picture`` is (H, W, 3) uint8 RGB."""
    options = (cv2.IMWRITE_WEBP_QUALITY, quality)
    return cv2.imencode(".webp", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), options)[1].tobytes()


def _small(picture: np.ndarray) -> bytes:
    scale = min(1.0, WIDTH_PX / picture.shape[1])
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return encoded(small)


def _heat(strength: np.ndarray) -> np.ndarray:
    small = cv2.applyColorMap(np.clip(strength, 0, 255).astype(np.uint8), cv2.COLORMAP_MAGMA)
    large = cv2.resize(small, None, fx=HEAT_PX, fy=HEAT_PX, interpolation=cv2.INTER_NEAREST)
    return cv2.cvtColor(large, cv2.COLOR_BGR2RGB)
