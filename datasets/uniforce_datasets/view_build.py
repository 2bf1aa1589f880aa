"""Build a training view: videos decoded once, cameras resized, touch encoded by the frozen tokenizer.

Stock LeRobot decodes six videos for every training sample.  A view reads arrays instead.
"""

import json
import logging
import os
import shutil
from collections.abc import Callable, Generator, Mapping, Sequence
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
from uniforce_datasets.source import Episode, episode_frames
from uniforce_datasets.view_plan import (
    TOUCH_STREAMS,
    EpisodeFacts,
    ViewPlan,
    ViewSettings,
    plan_view,
    touch_stream,
)
from uniforce_vtla.contracts import FINGERS, Finger, check_marker_image
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import CAMERAS, VIEW_MARKER, camera_key, tactile_key
from uniforce_vtla.options import absolute
from uniforce_vtla.results_file import only_writer, write_json
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.plain_touch import descriptors, marker_pairs


class LatentEncoder(Protocol):
    """Encoder that a training view uses."""

    @property
    def hash(self) -> str:
        """Identity of the weights; policies refuse latents of another one."""

    def __call__(self, reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
        """Return (B, K·latent) float32 from a (H, W) reference and (B, H, W) images as the sensor saw them."""


class PooledTokenizer:
    """A frozen tokenizer with its latents pooled to grid × grid.

    Args:
        tokenizer: it, the folder it is in, or None for the shipped one.
        grid: cells per side.
    """

    def __init__(self, tokenizer: Tokenizer | str | Path | None, grid: int) -> None:
        found = (
            tokenizer
            if isinstance(tokenizer, Tokenizer)
            else Tokenizer.from_pretrained(tokenizer or None)
        )
        self._tokenizer, self._grid, self.hash = found, grid, found.hash

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

    Raises DatasetError: a dataset can't be trusted, no episode is left, or ``out`` holds something else; ContractError:
    another process builds it.
    """
    encoder = encoder or PooledTokenizer(tokenizer, latent_grid)
    settings = ViewSettings(image_side, latent_grid, dict(slots or DEFAULT_SLOTS), encoder.hash)
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
    """Return whether ``out`` is this view already; raise DatasetError if it holds something else."""
    marker = out / VIEW_MARKER
    if marker.is_file():
        same = json.loads(marker.read_text()) == json.loads(json.dumps(plan.marker))
        return same and _whole(out)
    if out.exists() and any(out.iterdir()):
        raise DatasetError(
            expected(str(out), "no folder, or an older view", "other files", "Choose another out.")
        )
    return False


def _whole(view: Path) -> bool:
    try:
        check_hashes(view)
    except DatasetError as error:
        logger.warning("built anew: %s", error)
        return False
    return True


@dataclass(frozen=True)
class _Job:
    """One episode to decode and encode, in this process or another."""

    episode: Episode
    fps: int
    side: int
    encoder: LatentEncoder


def _write_frames(plan: ViewPlan, encoder: LatentEncoder, building: Path, workers: int) -> None:
    done = _resume(plan, building)
    arrays: dict[str, np.ndarray] = {}
    starts = plan.starts
    bar = tqdm(total=plan.num_frames, initial=int(starts[done]), desc="view", unit="frame")
    side, left = plan.settings.image_side, plan.episodes[done:]
    jobs = [_Job(episode, source.fps, side, encoder) for source, episode in left]
    with bar, closing(_in_turn(jobs, workers)) as blocks:
        for number, episode_blocks in enumerate(blocks, done):
            for name, block in episode_blocks.items():
                if name not in arrays:
                    arrays[name] = _open(building, name, plan.num_frames, block)
                arrays[name][starts[number] : starts[number + 1]] = block
            for array in arrays.values():
                array.flush()  # type: ignore[attr-defined]
            write_json(building / PROGRESS, {"content": plan.marker["content"], "done": number + 1})
            bar.update(int(starts[number + 1] - starts[number]))
    (building / PROGRESS).unlink(missing_ok=True)


def _in_turn(jobs: Sequence[_Job], workers: int) -> Generator[dict[str, np.ndarray]]:
    """Yield the episodes' blocks in order, whichever process made them."""
    if workers <= 1:
        yield from map(_episode_blocks, jobs)
        return
    with get_context("spawn").Pool(workers, _one_thread) as pool:
        yield from pool.imap(_episode_blocks, jobs)


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


def _open(building: Path, name: str, frames: int, block: np.ndarray) -> np.ndarray:
    path, shape = building / f"{name}.npy", (frames, *block.shape[1:])
    if path.is_file():
        array = np.lib.format.open_memmap(path, mode="r+")
    else:
        array = np.lib.format.open_memmap(path, mode="w+", dtype=block.dtype, shape=shape)
    # a full disk is an error now, and none when a page is written: that is a SIGBUS
    with path.open("rb+") as file:
        os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
    return array


def _episode_blocks(job: _Job) -> dict[str, np.ndarray]:
    """Return each stream's name and its (length, …) block."""
    blocks = {}
    for camera in CAMERAS:
        frames = episode_frames(job.episode.videos[camera_key(camera)], job.episode.length, job.fps)
        blocks[camera] = np.stack([resize(frame, job.side) for frame in frames])
    for finger in FINGERS:
        blocks |= _touch(job, finger)
    return blocks


def resize(image: np.ndarray, side: int) -> np.ndarray:
    """Return a square (H, H, 3) image area-resized to (side, side, 3)."""
    if image.shape[0] != image.shape[1]:
        raise DatasetError(expected("camera", "square images", image.shape, "Crop when recording."))
    return cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA)


def _touch(job: _Job, finger: Finger) -> dict[str, np.ndarray]:
    """Return a finger's latents (length, K·latent), and the two controls: descriptors and small image pairs."""
    episode, encoder = job.episode, job.encoder
    spans = episode.videos[tactile_key(finger, reference=True)], episode.videos[tactile_key(finger)]
    reference = next(episode_frames(spans[0], episode.length, job.fps))[..., 0]
    current = episode_frames(spans[1], episode.length, job.fps)
    parts: dict[str, list[np.ndarray]] = {name: [] for name in TOUCH_STREAMS}
    for frames in batched(current, BATCH):
        images = np.stack(
            [check_marker_image(frame[..., 0], tactile_key(finger)) for frame in frames]
        )
        parts["latent"].append(encoder(reference, images, finger).astype(np.float32))
        parts["descriptor"].append(descriptors(reference, images, finger))
        parts["marker_pair"].append(marker_pairs(reference, images, finger))
    return {touch_stream(name, finger): np.concatenate(blocks) for name, blocks in parts.items()}
