"""Newtons of a recorded episode's fingers, frame after frame, and how their latents change."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch

from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.source import Episode, Source, episode_frames
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.evaluation.finger_estimates import FingerEstimate, estimate_events
from uniforce_vtla.keys import AXES, STATE, sensor_key, tactile_key, truth_wrench_key
from uniforce_vtla.markers.mirror import to_canonical
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.descriptor_head import DescriptorHead
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.plain_touch import descriptors
from uniforce_vtla.tokenizer.streaming import StreamingEncoder

HEIGHT = AXES.index("z.pos")


@dataclass(frozen=True, eq=False)
class EpisodeForces:
    """Both fingers over an episode of n frames, and what the robot knew of itself.

    Attributes:
        time_s: (n,) since its first frame.
        tool_z_m: (n,) measured height.
        force_N: (n, 2, 3) left, right, canonical frame: estimates.
        true_force_N: the same from the simulator; None for a robot's recording.
    """

    time_s: np.ndarray
    tool_z_m: np.ndarray
    force_N: np.ndarray
    true_force_N: np.ndarray | None

    def judge(self, pad_friction: tuple[float, float]) -> tuple[FingerEstimate, FingerEstimate | None]:
        """Return the estimate from the fingers, and the same from true forces where there are any.

        Raises:
            ContractError, DatasetError: see ``estimate_events``.
        """
        found = estimate_events(self.time_s, self.force_N, self.tool_z_m, pad_friction)
        if self.true_force_N is None:
            return found, None
        return found, estimate_events(self.time_s, self.true_force_N, self.tool_z_m, pad_friction)


# newtons of one finger over an episode: (n, 3) in the canonical frame
ForceReader = Callable[[Source, Episode, Finger], np.ndarray]


class RecordingForces:
    """A recorded dataset behind a reader of forces; its numbers are read once for all episodes.

    Args:
        root: the dataset's folder.
        forces: reads newtons, e.g. ``descriptor_heads()``.
        verify: how the dataset is checked, see ``check_dataset``.

    Raises:
        DatasetError: a dataset that can't be read, or lacks a finger.
    """

    def __init__(self, root: str | Path, forces: ForceReader, verify: str = "quick") -> None:
        self.source = check_dataset(root, verify)
        if self.source.fingers != FINGERS:
            do = "Record marker images of both fingers."
            raise DatasetError(expected(str(root), f"fingers {FINGERS}", self.source.fingers, do))
        self._forces = forces
        self._heights_m = self.source.columns((STATE,))[STATE][:, HEIGHT].astype(np.float64)  # (N,)
        self._true_N = _true_forces(self.source)

    def read(self, episode: Episode) -> EpisodeForces:
        """Return an episode's forces; raise DatasetError where its videos can't be read."""
        rows = slice(episode.start, episode.start + episode.length)
        return EpisodeForces(
            np.arange(episode.length) / self.source.fps,
            self._heights_m[rows],
            np.stack([self._forces(self.source, episode, finger) for finger in FINGERS], axis=1),
            None if self._true_N is None else self._true_N[rows],
        )


def descriptor_heads(folder: str = "") -> ForceReader:
    """Return a reader of hand descriptors, never through the tokenizer a policy may have acted on: the one for scores.

    Args:
        folder: of python -m benchmarks.descriptor_heads; empty for the shipped ones, of the wiping scene.
    """
    load = cache(lambda sensor: DescriptorHead.from_pretrained(sensor, folder or None))

    def read(source: Source, episode: Episode, finger: Finger) -> np.ndarray:
        reference, current = marker_images(source, episode, finger)
        described = [descriptors(reference, image[None], finger)[0] for image in current()]
        return load(worn(source, episode, finger)).read(np.stack(described))

    return read


def force_head(tokenizer: Tokenizer, head: ForceHead) -> ForceReader:
    """Return a reader of the latents: what a force head makes of them, frame after frame, as on the robot.

    Raises:
        CheckpointError: (when read) a head that was trained on another tokenizer's latents.
    """

    def read(source: Source, episode: Episode, finger: Finger) -> np.ndarray:
        reference, current = marker_images(source, episode, finger)
        stream = StreamingEncoder(tokenizer, finger, head)
        stream.set_reference(reference)
        read_N = [stream.step(image).force_N for image in current()]
        return np.stack([force for force in read_N if force is not None]).astype(np.float64)

    return read


def latent_change(tokenizer: Tokenizer, source: Source, episode: Episode, finger: Finger) -> np.ndarray:
    """Return (n, g, g, L) float32: each patch's latent minus its free-air latent, as the sensor sees it."""
    reference, current = marker_images(source, episode, finger)
    stream = StreamingEncoder(tokenizer, finger)
    stream.set_reference(reference)
    rest = stream.step(reference).latent
    latents = torch.stack([stream.step(image).latent for image in current()])  # (n, P, L)
    side = math.isqrt(tokenizer.num_patches)
    maps = (latents - rest).unflatten(1, (side, side)).movedim(-1, 1)  # (n, L, g, g)
    return to_canonical(maps, finger).movedim(1, -1).numpy()  # undoes the encoder's mirror: its own inverse


def marker_images(
    source: Source, episode: Episode, finger: Finger
) -> tuple[np.ndarray, Callable[[], map[np.ndarray]]]:
    """Return an episode's reference (H, W), and what yields its marker images (H, W) one by one."""
    spans = [episode.videos[tactile_key(finger, reference=r)] for r in (True, False)]
    reference = next(episode_frames(spans[0], episode.length, source.fps))
    return _grey(reference), lambda: map(_grey, episode_frames(spans[1], episode.length, source.fps))


def worn(source: Source, episode: Episode, finger: Finger) -> str:
    """Return the name of the sensor on a finger; raise DatasetError where the dataset names none we know."""
    key, names = sensor_key(finger), list_sensors()
    if key not in source.features:
        raise DatasetError(expected(str(source.root), key, "no such column", "Record it with this version."))
    index = int(source.columns((key,))[key][episode.start])
    if not 0 <= index < len(names):
        raise DatasetError(expected(f"{key} in {source.root}", " | ".join(names), index, "Restore it."))
    return names[index]


def _grey(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[..., 0])


def _true_forces(source: Source) -> np.ndarray | None:
    """Return (N, 2, 3) of a simulated recording; a robot's has none."""
    keys = tuple(truth_wrench_key(finger) for finger in FINGERS)
    if not set(keys) <= source.features.keys():
        return None
    columns = source.columns(keys)
    return np.stack([columns[key][:, :3] for key in keys], axis=1).astype(np.float64)
