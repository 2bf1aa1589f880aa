"""A training view in the place of a LeRobotDataset, read from arrays by LeRobot's trainer."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
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
from uniforce_datasets.view_plan import TASK_INDEX, latent_array, mounted_sensors, read_marker
from uniforce_vtla import keys
from uniforce_vtla.array_file import read_array
from uniforce_vtla.contracts import check_finger
from uniforce_vtla.errors import DatasetError, expected, require_one_of
from uniforce_vtla.options import absolute

__all__ = ["TrainingView", "ViewMetadata", "build_view", "make_training_dataset"]

logger = logging.getLogger(__name__)
LOCAL_NAMES = "local/"  # begin of repo ids of datasets that never were on the hub
SNAPSHOTS = "snapshots"  # of the hub's cache: links into the folder beside it
# feature key of a slot, by touch input; "none" has no features
TOUCH_KEYS = {
    "latent": keys.latent_key,
    "wrench": keys.wrench_key,
}


@dataclass
class ViewMetadata:
    """The part of LeRobot's dataset metadata that its trainer and policies read.

    Totals are the whole view's, which LeRobot's sampler indexes; ``used_…``, ``sensors`` and
    ``stats`` are of the episodes sampled from.
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


class TrainingView(Dataset):
    """Frames of a view as LeRobot's trainer expects them.

    A sample holds the cameras (3, S, S) uint8, the state, a chunk of actions with
    ``action_is_pad``, one touch input per slot, and the instruction of its frame in words.

    Args:
        root: folder written by ``build_view``.
        action_deltas: frames of the action relative to the sample; −1 is the command before it.
        slots: which finger fills which slot; None takes the view's own.
        touch: "latent" | "none" | "wrench", the simulator's true one.
        episodes: numbers of the episodes to sample from; None is all.
        image_transforms: applied to each camera image.
        verify: "full" and "quick" compare the SHA-256 of every array; "off" doesn't.

    Raises DatasetError: not a whole view, an array that changed, or no true wrench though one is
    asked for.
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
        # samples are addressed by their index in the whole view
        self.absolute_to_relative_idx = None
        self._transform = image_transforms
        facts = self.marker["episodes"]
        self._starts = np.cumsum([0, *(episode["length"] for episode in facts)])  # (E + 1,)
        self._tasks = self.marker.get("tasks") or sorted({episode["task"] for episode in facts})
        self.episodes = None
        self._sampled: Sequence[int] = range(len(facts))
        if episodes is not None:
            self.episodes = list(episodes)
            self._sampled = self.episodes
        self.meta = self._metadata()

    @property
    def num_frames(self) -> int:
        """Frames of the episodes sampled from."""
        return int(np.diff(self._starts)[self._sampled].sum())

    @property
    def num_episodes(self) -> int:
        """Episodes sampled from."""
        return len(self._sampled)

    @property
    def features(self) -> dict[str, dict]:
        """LeRobot's features dict."""
        return self.meta.features

    def __len__(self) -> int:
        """Frames in the view, sampled from or not: LeRobot's sampler uses whole-view indices."""
        return int(self._starts[-1])

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Return one sample as LeRobotDataset would, images as uint8."""
        episode = int(np.searchsorted(self._starts, index, side="right")) - 1
        start = self._starts[episode]
        end = self._starts[episode + 1]
        frame = int(index - start)
        task_index = int(self._task_index[index])
        wanted = index + self._deltas  # (T,)
        actions = self._arrays[keys.ACTION][wanted.clip(start, end - 1)]
        sample: dict[str, Any] = {
            keys.STATE: torch.from_numpy(self._arrays[keys.STATE][index].copy()),
            keys.ACTION: torch.from_numpy(actions),  # (T, 5)
            f"{keys.ACTION}_is_pad": torch.from_numpy((wanted < start) | (wanted >= end)),  # (T,)
            "timestamp": torch.tensor(frame / self.marker["fps"], dtype=torch.float32),
            "frame_index": torch.tensor(frame),
            "episode_index": torch.tensor(episode),
            "index": torch.tensor(index),
            "task_index": torch.tensor(task_index),
            keys.TASK: self._tasks[task_index],
        }
        for camera in keys.CAMERAS:
            image = self._arrays[camera][index].transpose(2, 0, 1)  # (3, S, S)
            sample[keys.camera_key(camera)] = torch.from_numpy(image.copy())
            if self._transform is not None:
                sample[keys.camera_key(camera)] = self._transform(sample[keys.camera_key(camera)])
        for key, name in self._touch.items():
            sample[key] = torch.from_numpy(self._arrays[name][index].copy())
        return sample

    @cached_property
    def _arrays(self) -> dict[str, np.ndarray]:
        """Images stay on disk, mapped; numbers are read."""
        arrays = {}
        for name in (*keys.CAMERAS, keys.STATE, keys.ACTION, *self._touch.values()):
            arrays[name] = read_array(self.root / f"{name}.npy", mapped=name in keys.CAMERAS)
            self._check_array(name, arrays[name])
        return arrays

    def _check_array(self, name: str, array: np.ndarray) -> None:
        side = self.marker["image_side"]
        if name in keys.CAMERAS:
            fits = array.shape == (len(self), side, side, 3) and array.dtype == np.uint8
        elif name == TASK_INDEX:
            fits = array.shape == (len(self),) and array.dtype == np.int64
            fits = fits and bool(((array >= 0) & (array < len(self._tasks))).all())
        else:
            fits = array.ndim == 2 and len(array) == len(self) and array.dtype.kind == "f"
        if not fits:
            file = str(self.root / f"{name}.npy")
            came = f"{array.shape} {array.dtype}"
            do = "Build the view again."
            raise DatasetError(expected(file, f"{len(self)} frames of it", came, do))

    @cached_property
    def _task_index(self) -> np.ndarray:
        """(N,) number of each frame's instruction; stored where it changes within an episode."""
        if "tasks" in self.marker:
            stored = read_array(self.root / f"{TASK_INDEX}.npy")
            self._check_array(TASK_INDEX, stored)
            return stored
        numbers = [self._tasks.index(episode["task"]) for episode in self.marker["episodes"]]
        return np.repeat(numbers, np.diff(self._starts))

    def __getstate__(self) -> dict[str, Any]:
        """Leave the arrays out: a loader's worker opens its own."""
        state = self.__dict__.copy()
        state.pop("_arrays", None)
        state.pop("_task_index", None)
        return state

    def _touch_columns(self, slots: Mapping[str, str], touch: str) -> dict[str, str]:
        """Return the array of each touch feature, by feature key."""
        require_one_of("touch", touch, (*TOUCH_KEYS, "none"))
        if touch == "wrench" and not self.marker["wrench"]:
            do = "Only simulated demos know it: use touch latents."
            raise DatasetError(expected(str(self.root), "the true wrench", "none", do))
        columns: dict[str, str] = {}
        if touch == "none":
            return columns
        for slot, name in slots.items():
            finger = check_finger(name)
            array = latent_array(finger)
            if touch == "wrench":
                array = keys.truth_wrench_key(finger)
            columns[TOUCH_KEYS[touch](slot)] = array
        return columns

    def _metadata(self) -> ViewMetadata:
        rows = np.zeros(len(self), dtype=bool)
        sampled = []
        for number in self._sampled:
            rows[self._starts[number] : self._starts[number + 1]] = True
            sampled.append(self.marker["episodes"][number])
        stats = {}
        for key, name in {keys.STATE: keys.STATE, keys.ACTION: keys.ACTION, **self._touch}.items():
            stats[key] = pooled_stats(self._arrays[name][rows])
        tasks = []
        names = np.array(self._tasks, dtype=object)
        for start, end in pairwise(self._starts):
            tasks.append(names[np.unique(self._task_index[start:end])].tolist())
        return ViewMetadata(
            root=self.root,
            fps=self.marker["fps"],
            features=self._features(),
            stats=stats,
            episodes={
                "dataset_from_index": self._starts[:-1].tolist(),
                "dataset_to_index": self._starts[1:].tolist(),
                "tasks": tasks,
            },
            sensors=mounted_sensors(sampled),
            camera_keys=list(map(keys.camera_key, keys.CAMERAS)),
            total_episodes=len(tasks),
            total_frames=len(self),
            used_episodes=self.num_episodes,
            used_frames=self.num_frames,
        )

    def _features(self) -> dict[str, dict]:
        side = self.marker["image_side"]
        features: dict[str, dict] = {}
        for camera in keys.CAMERAS:
            names = ["height", "width", "channels"]
            picture = {"dtype": "image", "shape": (side, side, 3), "names": names}
            features[keys.camera_key(camera)] = picture
        features[keys.STATE] = vector_column(keys.AXES)
        features[keys.ACTION] = vector_column(keys.AXES)
        for key, name in self._touch.items():
            numbers = self._arrays[name].shape[1]
            if numbers == len(WRENCH_AXES):
                features[key] = vector_column(WRENCH_AXES)
            else:
                features[key] = vector_column([f"z{i}" for i in range(numbers)])
        return features


def make_training_dataset(
    cfg: Any, stock_make_dataset: Callable[[Any], Any], verify: str = ""
) -> Any:
    """Return a TrainingView where ``cfg.dataset.root`` is one, else what LeRobot itself makes.

    The policy's own settings choose the action frames, slots and touch input; a policy without
    touch slots gets cameras, state and action only.

    Args:
        cfg: LeRobot's training config.
        stock_make_dataset: LeRobot's own function.
        verify: see ``check_dataset``; "" is "quick" for a dataset of this machine (``local/…``),
            else "full".

    Raises DatasetError: a dataset or view that isn't what was saved, a path or link that leads out
    of it, the policy pools latents to another grid, or asks for observation histories.
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
    if deltas is None:
        deltas = (0,)
    transforms = None
    if cfg.dataset.image_transforms.enable:
        from lerobot.transforms import ImageTransforms

        transforms = ImageTransforms(cfg.dataset.image_transforms)
    return TrainingView(
        root, deltas, slots, touch, cfg.dataset.episodes, transforms, verify or "quick"
    )


def _stock_dataset(cfg: Any, stock_make_dataset: Callable[[Any], Any], verify: str) -> Any:
    """Return LeRobot's own dataset, checked before, or after it was downloaded."""
    from uniforce_datasets.scene_transforms import spare_marker_images

    root = cfg.dataset.root
    if not verify:
        verify = "quick" if str(cfg.dataset.repo_id).startswith(LOCAL_NAMES) else "full"
    check_verify(verify)
    if root is not None and (Path(root) / INFO).is_file():
        check_dataset(root, verify)
        dataset = stock_make_dataset(cfg)
        spare_marker_images(dataset, cfg.dataset)
        return dataset
    dataset = stock_make_dataset(cfg)
    spare_marker_images(dataset, cfg.dataset)
    if cfg.dataset.streaming or cfg.dataset.episodes is not None:
        logger.warning("%s isn't checked: only a part of it is downloaded.", cfg.dataset.repo_id)
        return dataset
    snapshot = Path(dataset.root)
    within = None
    if snapshot.parent.name == SNAPSHOTS:
        within = snapshot.parents[1]
    check_dataset(snapshot, verify, within)
    return dataset
