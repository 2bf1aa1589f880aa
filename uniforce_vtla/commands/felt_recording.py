"""What the fingers of a recorded episode felt: latents and newtons frame after frame, as on the robot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from uniforce_datasets.source import Episode, Source, episode_frames, read_source
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.evaluation.finger_estimates import FingerEstimate, estimate_events
from uniforce_vtla.keys import AXES, STATE, tactile_key, truth_wrench_key
from uniforce_vtla.markers.mirror import to_canonical
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.streaming import StreamingEncoder

HEIGHT = AXES.index("z.pos")


@dataclass(frozen=True, eq=False)
class FeltFinger:
    """One finger over an episode of n frames.

    Attributes:
        force_N: (n, 3) in the canonical frame, estimated by a force head.
        change: (n, g, g, L) float32, each patch's latent minus its free-air latent; as the sensor sees it.
    """

    force_N: np.ndarray
    change: np.ndarray

    @property
    def strength(self) -> np.ndarray:
        """(n, g, g) length of each patch's change."""
        return np.linalg.norm(self.change, axis=-1)


@dataclass(frozen=True, eq=False)
class FeltEpisode:
    """Both fingers over an episode of n frames, and what the robot knew of itself.

    Attributes:
        time_s: (n,) since its first frame.
        tool_z_m: (n,) measured height.
        fingers: by name.
        true_force_N: (n, 2, 3) left, right, canonical frame, from the simulator; None for a robot's recording.
    """

    time_s: np.ndarray
    tool_z_m: np.ndarray
    fingers: dict[Finger, FeltFinger]
    true_force_N: np.ndarray | None

    def forces(self) -> np.ndarray:
        """Return (n, 2, 3) N, left and right: estimates."""
        return np.stack([self.fingers[finger].force_N for finger in FINGERS], axis=1)

    def judge(self, pad_friction: tuple[float, float]) -> tuple[FingerEstimate, FingerEstimate | None]:
        """Return the estimate from the fingers, and the same from true forces where there are any.

        Raises:
            ContractError, DatasetError: see ``estimate_events``.
        """
        found = estimate_events(self.time_s, self.forces(), self.tool_z_m, pad_friction)
        if self.true_force_N is None:
            return found, None
        return found, estimate_events(self.time_s, self.true_force_N, self.tool_z_m, pad_friction)


class FeltRecording:
    """A recorded dataset behind a tokenizer and a force head; its numbers are read once for all episodes.

    Args:
        root: the dataset's folder.
        tokenizer: checkpoint folder; empty for the shipped one.
        head: name of a shipped force head, or a folder.

    Raises:
        DatasetError: a dataset that can't be read, or lacks a finger.
        CheckpointError: a tokenizer or head that can't be loaded.
    """

    def __init__(self, root: str | Path, tokenizer: str = "", head: str = "wiping") -> None:
        self.source = read_source(root)
        if self.source.fingers != FINGERS:
            do = "Record marker images of both fingers."
            raise DatasetError(expected(str(root), f"fingers {FINGERS}", self.source.fingers, do))
        self.tokenizer = Tokenizer.from_pretrained(tokenizer or None)
        folder = Path(head)
        self._head = ForceHead.from_pretrained(head, folder if folder.is_dir() else None)
        self._heights_m = self.source.columns((STATE,))[STATE][:, HEIGHT].astype(np.float64)  # (N,)
        self._true_N = _true_forces(self.source)

    def feel(self, episode: Episode) -> FeltEpisode:
        """Return what an episode's fingers felt; raise DatasetError where its videos can't be read."""
        rows = slice(episode.start, episode.start + episode.length)
        return FeltEpisode(
            np.arange(episode.length) / self.source.fps,
            self._heights_m[rows],
            {finger: self._finger(episode, finger) for finger in FINGERS},
            None if self._true_N is None else self._true_N[rows],
        )

    def _finger(self, episode: Episode, finger: Finger) -> FeltFinger:
        spans = [episode.videos[tactile_key(finger, reference=r)] for r in (True, False)]
        references, current = (episode_frames(span, episode.length, self.source.fps) for span in spans)
        reference = grey(next(references))
        free = StreamingEncoder(self.tokenizer, finger)
        free.set_reference(reference)
        rest = free.step(reference).latent
        stream = StreamingEncoder(self.tokenizer, finger, self._head)
        stream.set_reference(reference)
        steps = [stream.step(grey(frame)) for frame in current]
        side = math.isqrt(self.tokenizer.num_patches)
        change = (torch.stack([step.latent for step in steps]) - rest).unflatten(1, (side, side)).numpy()
        as_seen = to_canonical(np.moveaxis(change, -1, 1), finger)  # undoes the encoder's mirror
        said = np.stack([step.force_N for step in steps if step.force_N is not None])
        return FeltFinger(said.astype(np.float64), np.moveaxis(as_seen, 1, -1))


def grey(image: np.ndarray) -> np.ndarray:
    """Return the (H, W) marker image of a stored (H, W, 3) one."""
    return np.ascontiguousarray(image[..., 0])


def _true_forces(source: Source) -> np.ndarray | None:
    """Return (N, 2, 3) of a simulated recording; a robot's has none."""
    keys = tuple(truth_wrench_key(finger) for finger in FINGERS)
    if not set(keys) <= source.features.keys():
        return None
    columns = source.columns(keys)
    return np.stack([columns[key][:, :3] for key in keys], axis=1).astype(np.float64)
