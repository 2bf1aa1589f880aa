"""Films of grasps in their authors' form, made here: each trial once, by name and campaign; broken
ones by name."""

import shutil

import cv2
import numpy as np
import pytest

from benchmarks.real.films import film_frames
from benchmarks.real.gelsight_grasps import FILMS, WIDE_FRAMES, read_grasps
from uniforce_vtla.errors import DatasetError

SIDE_PX = 64
NUTS = "base_data_for_training/bag_of_nuts/exp_num_1"
MUG = "base_data_for_training/mug/exp_num_1"


def film(path, frames, shade):
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25, (SIDE_PX, SIDE_PX))
    for number in range(frames):
        writer.write(np.full((SIDE_PX, SIDE_PX, 3), (shade + number) % 200, np.uint8))
    writer.release()


def trial(folder, frames, shade):
    for number, name in enumerate(FILMS.values()):
        film(folder / name, frames, shade + number)
    return folder


@pytest.fixture
def grasps(tmp_path):
    first = trial(tmp_path / NUTS, 12, 0)
    (first / "slip.txt").touch()
    trial(tmp_path / MUG, WIDE_FRAMES, 40)
    shutil.copytree(first, tmp_path / "bag_nuts" / "exp_num_1")
    shutil.copytree(first, (tmp_path / "base_data" / NUTS).with_name("exp_num_7"))
    return tmp_path


def test_a_trial_that_stands_three_times_is_read_once_by_its_objects_name(grasps):
    nuts, mug = read_grasps(grasps)
    assert (nuts.object_name, nuts.name) == ("bag_of_nuts", NUTS)
    assert (nuts.campaign, mug.campaign) == ("close", "wide")
    assert nuts.slipped and not mug.slipped
    frames = list(film_frames(nuts.films["left"]))
    assert len(frames) == 12 and frames[0].shape == (SIDE_PX, SIDE_PX, 3)


def test_a_trial_without_one_fingers_film_is_named(grasps):
    gone = grasps / MUG / FILMS["right"]
    gone.unlink()
    with pytest.raises(DatasetError, match=f"mug.*no {FILMS['right']}"):
        read_grasps(grasps)


def test_a_film_that_is_no_film_and_a_folder_without_any_are_named(grasps, tmp_path):
    broken = grasps / MUG / FILMS["left"]
    broken.write_bytes(b"RIFF no film")
    with pytest.raises(DatasetError, match="whole film"):
        read_grasps(grasps)
    with pytest.raises(DatasetError, match="whole film"):
        list(film_frames(broken))
    (empty := tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match="docs/franka-servo/datasets"):
        read_grasps(empty)


def test_a_link_out_of_the_data_set_is_refused(grasps, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside") / "film.avi"
    film(outside, 3, 0)
    inside = grasps / MUG / FILMS["left"]
    inside.unlink()
    inside.symlink_to(outside)
    with pytest.raises(DatasetError, match="a path inside"):
        read_grasps(grasps)
