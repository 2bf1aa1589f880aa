"""LeRobot's dataset with image transforms for scene cameras alone."""

from collections.abc import Callable
from typing import Any

from lerobot.datasets import LeRobotDataset

from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import TACTILE_KEYS


class SceneTransformsDataset(LeRobotDataset):
    """A dataset of LeRobot's, made by ``spare_marker_images``."""

    scene_transforms: Callable[[Any], Any]

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Return a frame, its scene cameras transformed."""
        row = super().__getitem__(index)
        for key in set(self.meta.camera_keys) - set(TACTILE_KEYS):
            row[key] = self.scene_transforms(row[key])
        return row


def spare_marker_images(dataset: Any, settings: Any) -> None:
    """Let a dataset that LeRobot made transform its scene cameras alone.

    LeRobot transforms every image key. A marker image that is blurred or turned is another touch.

    Args:
        dataset: LeRobot's, with marker images or without.
        settings: LeRobot's ``cfg.dataset``.

    Raises DatasetError: image transforms of marker images where LeRobot reads the frames itself:
    while streaming, and with ``eval_split``.
    """
    if not settings.image_transforms.enable:
        return
    if not set(dataset.meta.camera_keys) & set(TACTILE_KEYS):
        return
    if settings.streaming or settings.eval_split:
        came = "dataset.streaming" if settings.streaming else "dataset.eval_split"
        do = "Leave one of them out, or make a view of the dataset: `uniforce view`."
        raise DatasetError(expected("image transforms", "scene cameras alone", came, do))
    dataset.scene_transforms = dataset.image_transforms
    dataset.clear_image_transforms()
    dataset.__class__ = SceneTransformsDataset
