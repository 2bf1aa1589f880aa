"""References: steady ones pass, touched ones are refused where that can be known."""

import numpy as np
import pytest
import torch

from uniforce_vtla.errors import ContractError, SensorError
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.reference import ReferenceMemory, capture_camera_reference, capture_taxel_reference

FREE = np.random.default_rng(0).integers(15_000, 38_000, (16, 3))


def steady(frames: int = 20, sigma: float = 2.0) -> list[np.ndarray]:
    noise = np.random.default_rng(1).normal(0, sigma, (frames, 16, 3))
    return list(FREE + np.rint(noise).astype(np.int64))


def test_steady_scans_give_their_level():
    assert np.abs(capture_taxel_reference(steady()) - FREE).max() <= 2


def test_one_garbled_scan_is_no_touch():
    scans = steady()
    scans[7][15, 2] -= 286  # seen on a real trial's last frames
    assert np.abs(capture_taxel_reference(scans) - FREE).max() <= 2


def test_a_touch_that_builds_up_is_refused():
    scans = [scan + np.array([0, 0, 40 * i]) for i, scan in enumerate(steady())]
    with pytest.raises(SensorError, match="in contact"):
        capture_taxel_reference(scans)


def test_a_steady_touch_is_refused_against_a_resting_level_only():
    pressed = [scan + np.array([0, 0, 900]) for scan in steady()]
    with pytest.raises(SensorError, match="resting level"):
        capture_taxel_reference(pressed, resting_level=FREE)
    assert capture_taxel_reference(pressed).shape == (16, 3)  # it can't be known from the scans alone


def test_dead_scans_are_no_reference():
    with pytest.raises(SensorError, match="48 zeros"):
        capture_taxel_reference([np.zeros((16, 3), np.int64)] * 5)


@pytest.mark.parametrize("scans", [[], [FREE], [FREE, FREE], [FREE, FREE, FREE.astype(float)], [FREE[:3]] * 4])
def test_too_few_or_malformed_scans(scans):
    with pytest.raises(ContractError):
        capture_taxel_reference(scans)


def test_a_reference_taken_under_load_shows_once_released():
    pressed = FREE + np.array([0, 0, 1_500])
    with pytest.raises(SensorError, match="in contact"):
        Canonicalizer("uskin").pair(pressed, FREE, finger="left")


def test_steady_camera_frames_give_their_median(gel):
    frames = [gel(seed=0).frame] + [_renoised(gel(seed=0).frame, i) for i in range(4)]
    reference = capture_camera_reference(frames, _centres(frames))
    assert reference.dtype == np.uint8 and np.abs(reference.astype(int) - frames[0]).mean() < 4


def test_moving_markers_are_no_reference(dome):
    frames = [dome(rings=6).frame, dome(rings=6).frame, dome(rings=6, pressed=True).frame]
    frames[2] = np.roll(frames[2], 4, axis=1)
    with pytest.raises(SensorError, match="in contact"):
        capture_camera_reference(frames, _centres(frames, "tactip"))


def test_too_few_camera_frames(gel):
    frames = [gel().frame] * 2
    with pytest.raises(ContractError, match="at least 3"):
        capture_camera_reference(frames, _centres(frames))


def test_camera_frames_of_two_sizes(gel):
    frames = [gel().frame, gel().frame, gel(size=(320, 240)).frame]
    with pytest.raises(ContractError, match="one size"):
        capture_camera_reference(frames, _centres(frames))


@pytest.mark.parametrize("make", [np.array, torch.tensor])
def test_a_reference_is_remembered_by_key_and_content(make):
    """The identity every cache of references goes by: tokenizer, stream, policy and canonicalizer share it."""
    memory, made = ReferenceMemory(2), []

    def get(key, reference):
        return memory.get(key, reference, lambda: made.append(key) or len(made))

    image = make([[0, 255], [255, 0]])
    assert get("left", image) == get("left", make([[0, 255], [255, 0]])) == 1
    image[0, 0] = 255  # the same object with other content
    assert get("left", image) == 2 and get("left", make([[0, 255], [255, 0]])) == 1
    assert get("right", image) == 3 and get("left", image[:1]) == 4  # another key, another shape
    # another type; and two are kept, so the first is gone
    assert get("left", make([[0.0, 255.0], [255.0, 0.0]])) == 5
    assert get("left", make([[0, 255], [255, 0]])) == 6
    memory.forget()
    assert get("left", make([[0, 255], [255, 0]])) == 7


def _centres(frames: list[np.ndarray], sensor: str = "gelsight") -> list[np.ndarray]:
    return [Canonicalizer(sensor).markers(frame) for frame in frames]


def _renoised(frame: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, 3, frame.shape)
    return np.clip(frame + noise, 0, 255).astype(np.uint8)
