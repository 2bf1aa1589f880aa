"""Image transforms of LeRobot's trainer change scene cameras and leave marker images as they are
stored."""

import pickle
from types import SimpleNamespace

import pytest
import torch
from lerobot.datasets import LeRobotDataset

from uniforce_datasets.scene_transforms import spare_marker_images
from uniforce_datasets.synthetic import record_synthetic
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.keys import CAMERAS, TACTILE_KEYS, camera_key


def inverted(image):
    return 255 - image


def settings(**given):
    usual = {"streaming": False, "eval_split": 0.0}
    return SimpleNamespace(image_transforms=SimpleNamespace(enable=True), **usual | given)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return record_synthetic(tmp_path_factory.mktemp("transforms") / "demos", episodes=1, frames=4)


def opened(root, transforms=inverted):
    return LeRobotDataset(
        "local/synthetic", root=root, image_transforms=transforms, return_uint8=True
    )


def test_scene_cameras_are_transformed_and_marker_images_are_not(root):
    plain = opened(root, transforms=None)[2]
    dataset = opened(root)
    spare_marker_images(dataset, settings())
    for one in (dataset, pickle.loads(pickle.dumps(dataset))):  # as a loader's worker has it
        row = one[2]
        for camera in CAMERAS:
            assert torch.equal(row[camera_key(camera)], inverted(plain[camera_key(camera)]))
        for key in TACTILE_KEYS:
            assert torch.equal(row[key], plain[key])


@pytest.mark.parametrize("given", [{"streaming": True}, {"eval_split": 0.2}])
def test_where_lerobot_reads_the_frames_itself_transforms_are_refused(root, given):
    with pytest.raises(DatasetError, match="make a view"):
        spare_marker_images(opened(root), settings(**given))


def test_without_transforms_nothing_changes(root):
    dataset = opened(root, transforms=None)
    off = settings(eval_split=0.2)
    off.image_transforms.enable = False
    spare_marker_images(dataset, off)
    assert type(dataset) is LeRobotDataset
