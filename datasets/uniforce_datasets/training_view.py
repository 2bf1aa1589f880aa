"""A training view in the place of a LeRobotDataset: what LeRobot's trainer asks for, from arrays."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from uniforce_datasets.dataset_info import INFO
from uniforce_datasets.features import WRENCH_AXES, vector_column
from uniforce_datasets.hashes import check_hashes, check_verify
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.pooled_quantiles import pooled_stats
from uniforce_datasets.view_build import build_view
from uniforce_datasets.view_plan import read_marker, touch_stream
from uniforce_vtla import keys
from uniforce_vtla.array_file import read_array
from uniforce_vtla.contracts import FINGERS, check_finger
from uniforce_vtla.errors import DatasetError, expected, require_one_of
from uniforce_vtla.options import absolute

__all__ = ["TrainingView", "ViewMetadata", "build_view", "make_training_dataset"]

logger = logging.getLogger(__name__)
LOCAL_NAMES = "local/"  # begin of repo ids of datasets that never were on the hub
SNAPSHOTS = "snapshots"  # of the hub's cache: links into the folder beside it
TOUCH = ("latent", "wrench", "descriptor", "marker_pair", "none")
STREAM_KEYS = {
    "latent": keys.latent_key,
    "descriptor": keys.descriptor_key,
    "marker_pair": keys.marker_pair_key,
}


@dataclass(frozen=True)
class ViewMetadata:
    """The part of LeRobot's dataset metadata that its trainer and policies read.

    Totals are the whole view's, which LeRobot's sampler indexes; ``used_…``, ``sensors`` and ``stats`` are of the
    episodes sampled from.
    """

    root: Path
    fps: int
    features: dict[str, dict]
    stats: dict[str, dict[str, np.ndarray]]
    episodes: dict[str, list]
    sensors: dict[str, list[str]]
    camera_keys: list[str]
    total_episodes: int
    total_frames: int
    used_episodes: int
    used_frames: int
    repo_id: str = "local/view"
    has_language_columns: bool = False
    depth_keys: tuple[str, ...] = ()
    # feature key of a touch input → measured state (T, axes) and touch (T, numbers) of each episode sampled from
    touch_episodes: Callable[[str], Iterator[tuple[np.ndarray, np.ndarray]]] | None = None


class TrainingView(Dataset):
    """Frames of a view as LeRobot's trainer expects them.

    A sample holds the cameras (3, S, S) uint8, the state, a chunk of actions with ``action_is_pad``, one touch
    input per slot, and the task in words.

    Args:
        root: folder written by ``build_view``.
        action_deltas: frames of the action relative to the sample; −1 is the command before it.
        slots: which finger fills which slot; None takes the view's own.
        touch: "latent" | "none", or a control: "wrench" (the true one) | "descriptor" | "marker_pair".
        episodes: numbers of the episodes to sample from; None is all.
        image_transforms: applied to each camera image.
        verify: "full" and "quick" compare the SHA-256 of every array; "off" doesn't.

    Raises DatasetError: not a whole view, an array that changed, or no true wrench though one is asked for.
    """

    def __init__(
        self,
        root: str | Path,
        action_deltas: Sequence[int] = (0,),
        slots: Mapping[str, str] | None = None,
        touch: str = "latent",
        episodes: Sequence[int] | None = None,
        image_transforms: Callable[[torch.Tensor], torch.Tensor] | None = None,
        verify: str = "quick",
    ) -> None:
        self.root = absolute(root)
        self.marker = read_marker(self.root)
        if check_verify(verify) != "off":
            check_hashes(self.root)
        self._deltas = np.asarray(action_deltas, dtype=np.int64)
        self._touch = self._touch_columns(self.marker["slots"] if slots is None else slots, touch)
        self.episodes = None if episodes is None else list(episodes)
        # samples are addressed by their index in the whole view
        self.absolute_to_relative_idx = None
        self._transform = image_transforms
        self._tasks = [episode["task"] for episode in self.marker["episodes"]]
        self._starts = np.concatenate(
            [[0], np.cumsum([e["length"] for e in self.marker["episodes"]])]
        )
        self._task_names = sorted(set(self._tasks))
        _ = self._arrays
        self.meta = self._metadata()

    @property
    def num_frames(self) -> int:
        """Frames of the episodes sampled from."""
        if self.episodes is None:
            return int(self._starts[-1])
        return int(np.diff(self._starts)[self.episodes].sum())

    @property
    def num_episodes(self) -> int:
        """Episodes sampled from."""
        return len(self._tasks) if self.episodes is None else len(self.episodes)

    @property
    def features(self) -> dict[str, dict]:
        """LeRobot's features dict."""
        return self.meta.features

    def __len__(self) -> int:
        """Frames in the view, sampled from or not: the trainer's sampler uses whole-view indices."""
        return int(self._starts[-1])

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Return one sample as LeRobotDataset would, images as uint8."""
        episode = int(np.searchsorted(self._starts, index, side="right")) - 1
        start, end = self._starts[episode], self._starts[episode + 1]
        sample: dict[str, Any] = {
            keys.camera_key(camera): self._image(camera, index) for camera in keys.CAMERAS
        }
        sample[keys.STATE] = torch.from_numpy(self._arrays[keys.STATE][index].copy())
        wanted = index + self._deltas  # (T,)
        # (T, 5)
        sample[keys.ACTION] = torch.from_numpy(
            self._arrays[keys.ACTION][wanted.clip(start, end - 1)]
        )
        # (T,)
        sample[f"{keys.ACTION}_is_pad"] = torch.from_numpy((wanted < start) | (wanted >= end))
        for key, name in self._touch.items():
            sample[key] = torch.from_numpy(self._arrays[name][index].copy())
        return sample | self._place(index, episode, int(index - start))

    def _image(self, camera: str, index: int) -> torch.Tensor:
        image = torch.from_numpy(self._arrays[camera][index].transpose(2, 0, 1).copy())  # (3, S, S)
        return image if self._transform is None else self._transform(image)

    def _place(self, index: int, episode: int, frame: int) -> dict[str, Any]:
        return {
            "timestamp": torch.tensor(frame / self.marker["fps"], dtype=torch.float32),
            "frame_index": torch.tensor(frame),
            "episode_index": torch.tensor(episode),
            "index": torch.tensor(index),
            "task_index": torch.tensor(self._task_names.index(self._tasks[episode])),
            "task": self._tasks[episode],
        }

    @cached_property
    def _arrays(self) -> dict[str, np.ndarray]:
        """Images stay on disk, mapped; numbers are read."""
        names = (*keys.CAMERAS, keys.STATE, keys.ACTION, *self._touch.values())
        files = {name: self.root / f"{name}.npy" for name in names}
        arrays = {
            name: read_array(file, mapped=name in keys.CAMERAS) for name, file in files.items()
        }
        for name, array in arrays.items():
            _check_array(files[name], array, self.marker, picture=name in keys.CAMERAS)
        return arrays

    def __getstate__(self) -> dict[str, Any]:
        """Leave the arrays out: a loader's worker opens its own."""
        return {name: value for name, value in self.__dict__.items() if name != "_arrays"}

    def _touch_columns(self, slots: Mapping[str, str], touch: str) -> dict[str, str]:
        require_one_of("touch", touch, TOUCH)
        if touch == "wrench" and not self.marker["wrench"]:
            do = "Only simulated demos know it: use touch latents."
            raise DatasetError(expected(str(self.root), "the true wrench", "none", do))
        if touch in STREAM_KEYS:
            key = STREAM_KEYS[touch]
            return {
                key(slot): touch_stream(touch, check_finger(finger))
                for slot, finger in slots.items()
            }
        if touch == "wrench":
            return {
                keys.wrench_key(s): keys.truth_wrench_key(check_finger(finger))
                for s, finger in slots.items()
            }
        return {}

    def _metadata(self) -> ViewMetadata:
        # feature key → array name
        vectors = {keys.STATE: keys.STATE, keys.ACTION: keys.ACTION, **self._touch}
        used = self._used_frames()
        # no pictures
        vectors = {key: name for key, name in vectors.items() if self._arrays[name].ndim == 2}
        stats = {key: pooled_stats(self._arrays[name][used]) for key, name in vectors.items()}
        starts, ends = self._starts[:-1].tolist(), self._starts[1:].tolist()
        return ViewMetadata(
            root=self.root,
            fps=self.marker["fps"],
            features=self._features(),
            stats=stats,
            episodes={
                "dataset_from_index": starts,
                "dataset_to_index": ends,
                "tasks": [[t] for t in self._tasks],
            },
            sensors=self._sensors(),
            camera_keys=[keys.camera_key(camera) for camera in keys.CAMERAS],
            total_episodes=len(self._tasks),
            total_frames=len(self),
            used_episodes=self.num_episodes,
            used_frames=self.num_frames,
            touch_episodes=self.touch_episodes,
        )

    def touch_episodes(self, key: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the measured state (T, axes) and a touch input (T, numbers) of each episode sampled from."""
        numbers = range(len(self._tasks)) if self.episodes is None else self.episodes
        for number in numbers:
            rows = slice(self._starts[number], self._starts[number + 1])
            yield self._arrays[keys.STATE][rows], self._arrays[self._touch[key]][rows]

    def _sensors(self) -> dict[str, list[str]]:
        """Return finger → kinds worn in the episodes sampled from."""
        facts = self.marker["episodes"]
        used = facts if self.episodes is None else [facts[number] for number in self.episodes]
        return {
            finger: sorted({episode[f"{finger}_sensor"] for episode in used}) for finger in FINGERS
        }

    def _used_frames(self) -> np.ndarray:
        """(N,) bool: frames of the episodes sampled from."""
        lengths = np.diff(self._starts)
        used = np.ones(len(lengths), dtype=bool)
        if self.episodes is not None:
            used[:] = False
            used[self.episodes] = True
        return np.repeat(used, lengths)

    def _features(self) -> dict[str, dict]:
        side = self.marker["image_side"]
        picture = {
            "dtype": "image",
            "shape": (side, side, 3),
            "names": ["height", "width", "channels"],
        }
        features: dict[str, dict] = {
            keys.camera_key(camera): dict(picture) for camera in keys.CAMERAS
        }
        features |= {key: vector_column(keys.AXES) for key in (keys.STATE, keys.ACTION)}
        for key, name in self._touch.items():
            size = self._arrays[name].shape[1]
            if self._arrays[name].ndim > 2:
                shape = self._arrays[name].shape[1:]
                features[key] = {
                    "dtype": "uint8",
                    "shape": shape,
                    "names": ["pair", "height", "width"],
                }
                continue
            features[key] = vector_column(
                WRENCH_AXES if size == len(WRENCH_AXES) else [f"z{i}" for i in range(size)]
            )
        return features


def _check_array(file: Path, array: np.ndarray, marker: dict[str, Any], picture: bool) -> None:
    side = marker["image_side"]
    fits = (
        array.shape[1:] == (side, side, 3)
        if picture
        else array.ndim > 1 and array.dtype.kind in "fu"
    )
    if (
        array.shape[:1] != (marker["num_frames"],)
        or not fits
        or (picture and array.dtype != np.uint8)
    ):
        came = f"{array.shape} {array.dtype}"
        raise DatasetError(
            expected(
                str(file), f"{marker['num_frames']} frames of it", came, "Build the view again."
            )
        )


def make_training_dataset(
    cfg: Any, stock_make_dataset: Callable[[Any], Any], verify: str = ""
) -> Any:
    """Return a TrainingView where ``cfg.dataset.root`` is one, else what LeRobot itself makes.

    The policy's own settings choose the action frames, slots and touch input; a policy without touch slots gets
    cameras, state and action only.

    Args:
        cfg: LeRobot's training config.
        stock_make_dataset: LeRobot's own function.
        verify: see ``check_dataset``; "" is "quick" for a dataset of this machine (``local/…``), else "full".

    Raises DatasetError: a dataset or view that isn't what was saved, a path or link that leads out of it, the policy
    pools latents to another grid, or asks for observation histories.
    """
    root = cfg.dataset.root
    if root is None or not (Path(root) / keys.VIEW_MARKER).is_file():
        return _stock_dataset(cfg, stock_make_dataset, verify)
    policy = cfg.trainable_config
    if getattr(policy, "observation_delta_indices", None) is not None:
        raise DatasetError(
            expected("policy", "single observations", "a history", "Train on the dataset itself.")
        )
    slots = {slot: policy.finger_by_slot()[slot] for slot in getattr(policy, "slots", ())}
    touch = policy.touch_in_view if slots else "none"
    marker = read_marker(Path(root))
    if touch == "latent" and policy.latent_grid != marker["latent_grid"]:
        do = f"Build the view with latent_grid={policy.latent_grid}."
        raise DatasetError(
            expected("latent_grid of the view", policy.latent_grid, marker["latent_grid"], do)
        )
    deltas = policy.action_delta_indices
    deltas, transforms = (0,) if deltas is None else deltas, _transforms(cfg)
    return TrainingView(
        root, deltas, slots, touch, cfg.dataset.episodes, transforms, verify or "quick"
    )


def _stock_dataset(cfg: Any, stock_make_dataset: Callable[[Any], Any], verify: str) -> Any:
    """Return what LeRobot makes, checked before; what it has to download first is checked afterwards."""
    root, shared = cfg.dataset.root, not str(cfg.dataset.repo_id).startswith(LOCAL_NAMES)
    depth = check_verify(verify or ("full" if shared else "quick"))
    here = root is not None and (Path(root) / INFO).is_file()
    if here:
        check_dataset(root, depth)
    dataset = stock_make_dataset(cfg)
    if not here and (cfg.dataset.streaming or cfg.dataset.episodes is not None):
        logger.warning("%s isn't checked: only a part of it is downloaded.", cfg.dataset.repo_id)
    elif not here:
        snapshot = Path(dataset.root)
        cached = snapshot.parent.name == SNAPSHOTS
        check_dataset(snapshot, depth, within=snapshot.parents[1] if cached else None)
    return dataset


def _transforms(cfg: Any) -> Callable[[torch.Tensor], torch.Tensor] | None:
    if not cfg.dataset.image_transforms.enable:
        return None
    from lerobot.transforms import ImageTransforms

    return ImageTransforms(cfg.dataset.image_transforms)
