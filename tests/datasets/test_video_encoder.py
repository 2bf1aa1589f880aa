"""Videos while recording in real time: every stream comes back as it went in, one that stands still too."""

from pathlib import Path

import av
import numpy as np
import pytest

from uniforce_datasets.synthetic import dots
from uniforce_datasets.video_encoder import PerKeyEncoder
from uniforce_vtla.keys import camera_key, tactile_key

FRAMES = 12


def rgb(step: int) -> np.ndarray:
    return np.repeat(dots(step)[..., None], 3, axis=2)


def decoded(path: Path) -> np.ndarray:
    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


@pytest.mark.parametrize("changes", [(), (5,), (3, 4, 9)])
def test_marker_images_and_references_come_back_exactly(tmp_path: Path, changes: tuple[int, ...]) -> None:
    """A reference is converted once; a new one in the middle of an episode must still be seen."""
    moving, still = tactile_key("left"), tactile_key("left", reference=True)
    sent: dict[str, list[np.ndarray]] = {moving: [], still: []}
    encoder = PerKeyEncoder(30, queue_frames=2 * FRAMES, realtime=True)
    encoder.start_episode([moving, still], tmp_path)
    buffer = np.empty_like(rgb(0))  # rows come from memory that is used again
    for step in range(FRAMES):
        sent[moving].append(rgb(step))
        sent[still].append(rgb(100 + sum(step >= change for change in changes)))
        for key, frames in sent.items():
            buffer[:] = frames[-1]
            encoder.feed_frame(key, buffer.copy())
    written = encoder.finish_episode()
    for key, frames in sent.items():
        assert np.array_equal(decoded(written[key][0]), np.stack(frames)), key


def test_a_scene_camera_comes_back_about_as_it_was(tmp_path: Path) -> None:
    key = camera_key("front")
    ramp = np.linspace(0, 255, 96).astype(np.uint8)
    frames = [np.repeat(np.roll(ramp, step)[None, :, None], 64, 0).repeat(3, 2) for step in range(FRAMES)]
    encoder = PerKeyEncoder(30, queue_frames=2 * FRAMES, realtime=True)
    encoder.start_episode([key], tmp_path)
    for frame in frames:
        encoder.feed_frame(key, frame)
    shown = decoded(encoder.finish_episode()[key][0]).astype(int)
    assert np.abs(shown - np.stack(frames)).mean() < 6
