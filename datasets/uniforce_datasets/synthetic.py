"""A small dataset of moving dots and a stand-in for the tokenizer, for tests without simulation."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from uniforce_datasets.features import CAMERA_SHAPE
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_vtla import keys
from uniforce_vtla.contracts import FINGERS, MARKER_IMAGE_SHAPE, Finger

FPS = 30
DOT_PX = 12  # radius
PITCH_PX = 64


def dots(shift_px: float) -> np.ndarray:
    """Return a marker image (480, 640) of a regular grid of discs shifted to the right."""
    image = np.zeros(MARKER_IMAGE_SHAPE, dtype=np.uint8)
    for y in range(PITCH_PX // 2, MARKER_IMAGE_SHAPE[0], PITCH_PX):
        for x in range(PITCH_PX // 2, MARKER_IMAGE_SHAPE[1], PITCH_PX):
            cv2.circle(image, (round(x + shift_px), y), DOT_PX, 255, -1)
    return image


def synthetic_frame(step: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return one recordable frame; every number differs from frame to frame."""
    ramp = np.linspace(0, 200, CAMERA_SHAPE[1], dtype=np.uint8)
    picture = np.broadcast_to(np.roll(ramp, 3 * step)[None, :, None], CAMERA_SHAPE).copy()
    frame: dict[str, Any] = dict.fromkeys(map(keys.camera_key, keys.CAMERAS), picture)
    for finger in FINGERS:
        frame[keys.tactile_key(finger)] = dots(20 * np.sin(step / 5))
        frame[keys.tactile_key(finger, reference=True)] = dots(0)
        frame[keys.truth_wrench_key(finger)] = rng.normal(size=4).astype(np.float32)
        frame[keys.time_key(finger)] = np.array([step / FPS])
        frame[keys.age_key(finger)] = np.zeros(1, dtype=np.float32)
    frame[keys.STATE] = rng.normal(size=len(keys.AXES)).astype(np.float32)
    frame[keys.ACTION] = rng.normal(size=len(keys.AXES)).astype(np.float32)
    return frame


def record_synthetic(root: Path, episodes: int, frames: int, seed: int = 0) -> Path:
    """Record ``episodes`` of ``frames`` each with the real recorder."""
    rng = np.random.default_rng(seed)
    with EpisodeRecorder(root, "local/synthetic", "gelsight", "tactip", FPS) as recorder:
        for number in range(episodes):
            for step in range(frames):
                recorder.add(synthetic_frame(step, rng), "wipe the dots")
            recorder.save(success=True, outcome="success", seed=number)
    return root


class BlockMeans:
    """Stands in for the tokenizer where only the latents' size matters."""

    hash = "block means"

    def __call__(self, reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
        """Return (B, 96): as many numbers as 4×4 pooled latents of 6."""
        change = (current != reference).reshape(len(current), 96, -1)
        return change.mean(axis=2, dtype=np.float32)
