"""Build a training view: decode videos once, resize cameras, encode touch by the tokenizer.

Stock LeRobot decodes six videos for every training sample.  A view reads arrays instead.
"""

import json
import logging
import os
import shutil
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from itertools import batched
from multiprocessing import get_context
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import torch
from tqdm import tqdm

from uniforce_datasets.hashes import check_hashes, write_hashes
from uniforce_datasets.source import Episode, episode_frames, marker_images
from uniforce_datasets.view_plan import (
    EpisodeFacts,
    ViewPlan,
    ViewSettings,
    latent_array,
    plan_view,
)
from uniforce_vtla.contracts import FINGERS, Finger, check_marker_image
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import CAMERAS, VIEW_MARKER, tactile_key
from uniforce_vtla.options import absolute
from uniforce_vtla.results_file import only_writer, write_json
from uniforce_vtla.tokenizer import Tokenizer


class LatentEncoder(Protocol):
    """Encoder that a training view uses."""

    @property
    def hash(self) -> str:
        """Identity of the weights; policies refuse latents of another one."""

    def __call__(self, reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
        """Return (B, K·latent) float32 from a (H, W) reference and (B, H, W) images.

        Images are as the sensor saw them.
        """


class PooledTokenizer:
    """A frozen tokenizer with its latents pooled to grid × grid.

    Args:
        tokenizer: it, the folder it is in, or None for the shipped one.
        grid: pooled latents per side.
    """

    def __init__(self, tokenizer: Tokenizer | str | Path | None, grid: int) -> None:
        if not isinstance(tokenizer, Tokenizer):
            tokenizer = Tokenizer.from_pretrained(tokenizer or None)
        self._tokenizer = tokenizer
        self._grid = grid
        self.hash = tokenizer.hash
        self.size = grid**2 * tokenizer.model.config.latent  # numbers per image

    def __call__(self, reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
        """See ``LatentEncoder``."""
        latent = self._tokenizer.pooled(reference, current, finger, self._grid)
        return latent.flatten(1).numpy()  # (B, K·latent)


logger = logging.getLogger(__name__)
PROGRESS = "progress.json"
BATCH = 32  # frames encoded at once: 10 MB of marker images
DEFAULT_SLOTS = {"touch0": "right", "touch1": "left"}


def build_view(
    roots: str | Path | Sequence[str | Path],
    out: str | Path,
    image_side: int = 56,
    latent_grid: int = 4,
    slots: Mapping[str, str] | None = None,
    tokenizer: Tokenizer | str | Path | None = None,
    encoder: LatentEncoder | None = None,
    keep: Callable[[EpisodeFacts], bool] = lambda facts: facts.success,
    workers: int = 1,
    verify: str = "quick",
    cameras: Mapping[str, str] | None = None,
) -> Path:
    """Build the view of one or more recorded datasets; go on where an interrupted build stopped.

    Args:
        roots: dataset folder(s); several are joined in order.
        out: the view's folder; an older view there is replaced when the new one is whole.
        image_side: pixels per side of the stored camera images.
        latent_grid: latents are pooled to grid × grid.
        slots: which finger fills which slot by default; latents of both fingers are stored anyway.
        tokenizer: encoder of touch; None is the shipped one.
        encoder: anything else that encodes touch, instead of ``tokenizer``.
        keep: chooses episodes; clean successes by default.
        workers: processes that decode and encode, an episode each at a time.
        verify: how the datasets are checked, see ``check_dataset``.
        cameras: recorded name of the view's ``front`` and ``wrist`` camera where it is another.

    Raises DatasetError: a dataset can't be trusted, no episode is left, or ``out`` holds something
    else; ContractError: another process builds it.
    """
    encoder = encoder or PooledTokenizer(tokenizer, latent_grid)
    slots = dict(slots or DEFAULT_SLOTS)
    settings = ViewSettings(image_side, latent_grid, slots, encoder.hash, dict(cameras or {}))
    plan = plan_view([roots] if isinstance(roots, str | Path) else roots, settings, keep, verify)
    out = absolute(out)
    if _same_view(out, plan):
        return out
    building = out.with_name(out.name + ".building")
    with only_writer(building):
        _write_frames(plan, encoder, building, workers)
        for key, values in plan.columns.items():
            np.save(building / f"{key}.npy", values)
        write_json(building / VIEW_MARKER, plan.marker)
        write_hashes(building, {})
        shutil.rmtree(out, ignore_errors=True)
        building.rename(out)
    return out


def _same_view(out: Path, plan: ViewPlan) -> bool:
    """Return whether ``out`` is this view, undamaged; DatasetError: it holds something else."""
    marker = out / VIEW_MARKER
    if not marker.is_file():
        if out.exists() and any(out.iterdir()):
            do = "Choose another out."
            raise DatasetError(expected(str(out), "no folder, or an older view", "other files", do))
        return False
    if json.loads(marker.read_text()) != json.loads(json.dumps(plan.marker)):
        return False
    try:
        check_hashes(out)
    except DatasetError as error:
        logger.warning("built anew: %s", error)
        return False
    return True


@dataclass(frozen=True)
class _Job:
    """One episode to decode and encode, in this process or another."""

    episode: Episode
    fps: int
    settings: ViewSettings
    encoder: LatentEncoder


def _write_frames(plan: ViewPlan, encoder: LatentEncoder, building: Path, workers: int) -> None:
    done = _resume(plan, building)
    arrays: dict[str, np.memmap] = {}
    start = int(plan.starts[done])
    content = plan.marker["content"]
    jobs = []
    for _, episode in plan.episodes[done:]:
        jobs.append(_Job(episode, plan.fps, plan.settings, encoder))
    bar = tqdm(total=plan.num_frames, initial=start, desc="view", unit="frame")
    with bar, closing(_in_turn(jobs, workers)) as finished:
        for job, blocks in zip(jobs, finished, strict=True):
            end = start + job.episode.length
            for name, block in blocks.items():
                if name not in arrays:
                    arrays[name] = _open(building, name, plan.num_frames, block)
                arrays[name][start:end] = block
                arrays[name].flush()
            start = end
            done += 1
            write_json(building / PROGRESS, {"content": content, "done": done})
            bar.update(job.episode.length)
    (building / PROGRESS).unlink(missing_ok=True)


def _in_turn(jobs: Sequence[_Job], workers: int) -> Generator[dict[str, np.ndarray]]:
    """Yield the episodes' blocks in order, whichever process made them."""
    if workers <= 1:
        yield from map(_episode_blocks, jobs)
        return
    # unlike multiprocessing's pool it says so when a worker is killed, e.g. for its memory
    with ProcessPoolExecutor(workers, get_context("spawn"), _one_thread) as pool:
        yield from pool.map(_episode_blocks, jobs)


def _one_thread() -> None:
    """Processes share the cores already: more threads each only fight."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)


def _resume(plan: ViewPlan, building: Path) -> int:
    """Return how many episodes an earlier build of this very plan has finished."""
    progress = building / PROGRESS
    if progress.is_file():
        state = json.loads(progress.read_text())
        if state["content"] == plan.marker["content"]:
            return int(state["done"])
    shutil.rmtree(building, ignore_errors=True)
    building.mkdir(parents=True)
    return 0


def _open(building: Path, name: str, frames: int, block: np.ndarray) -> np.memmap:
    path = building / f"{name}.npy"
    if path.is_file():
        array = np.lib.format.open_memmap(path, mode="r+")
    else:
        shape = (frames, *block.shape[1:])
        array = np.lib.format.open_memmap(path, mode="w+", dtype=block.dtype, shape=shape)
    # a full disk is an error now, and none when a page is written: that is a SIGBUS
    with path.open("rb+") as file:
        os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
    return array


def _episode_blocks(job: _Job) -> dict[str, np.ndarray]:
    """Return each stream's name and its (length, …) block."""
    blocks = {}
    for camera in CAMERAS:
        video = job.episode.videos[job.settings.video_key(camera)]
        frames = episode_frames(video, job.episode.length, job.fps)
        blocks[camera] = np.stack([resize(frame, job.settings.image_side) for frame in frames])
    for finger in FINGERS:
        blocks[latent_array(finger)] = episode_latents(job.episode, job.fps, job.encoder, finger)
    return blocks


def resize(image: np.ndarray, side: int) -> np.ndarray:
    """Return a square (H, H, 3) image area-resized to (side, side, 3)."""
    if image.shape[0] != image.shape[1]:
        raise DatasetError(expected("camera", "square images", image.shape, "Crop when recording."))
    return cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA)


def episode_latents(
    episode: Episode, fps: int, encoder: LatentEncoder, finger: Finger
) -> np.ndarray:
    """Return a finger's latents (length, K·latent) float32."""
    reference, current = marker_images(episode, fps, finger)
    latents = []
    for some in batched(current, BATCH):
        images = np.stack([check_marker_image(image, tactile_key(finger)) for image in some])
        latents.append(encoder(reference, images, finger).astype(np.float32))
    return np.concatenate(latents)
