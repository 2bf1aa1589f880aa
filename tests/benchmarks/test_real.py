"""Recordings in their authors' form, made here: what is read, what a turned sensor's angle is, what
is refused."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmarks.real.readouts import (
    descriptor_features,
    fit_readout,
    labels_mm,
    latent_features,
    transfer,
)
from benchmarks.real.tactip_shear import SHEAR, marker_image, read_tactip_shear
from uniforce_vtla.contact import TactileSimulator, free_air, gap_map
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.tokenizer import Tokenizer

RADIUS_PX = 210


def presses(n):
    rng = np.random.default_rng(0)
    depth, shear = rng.uniform(1, 5, n), rng.uniform(-2, 2, (n, 2))
    force = np.column_stack([0.5 * shear, 3 * depth]).astype(np.float32)
    gap = np.repeat(gap_map("sphere", (0.0, 0.0), 0.0)[None], n, axis=0)
    names = [f"image_{k + 1}.png" for k in range(n)]
    table = pd.DataFrame({"sensor_image": names, "pose_z": depth})
    table[SHEAR] = shear
    return ContactState(gap, force, np.zeros(n, np.float32)), table


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("a") / "robot" / "surface_3d" / "train"
    (folder / "processed_images").mkdir(parents=True)
    contact, table = presses(40)
    simulator = TactileSimulator("tactip", seed=0)
    size = 2 * RADIUS_PX, 2 * RADIUS_PX  # the dome's 480 px, shrunk as theirs are
    images = *simulator.marker_images(free_air(1)), *simulator.marker_images(contact)
    for number, image in enumerate(images):
        shrunk = cv2.resize(image[:, 80:560], size, interpolation=cv2.INTER_AREA)
        name = folder / "processed_images" / f"image_{number}.png"
        cv2.imwrite(str(name), np.uint8(255) * (shrunk > 127))
    table.to_csv(folder / "targets_images.csv", index=False)
    facts = json.dumps({"circle_mask_radius": RADIUS_PX})
    (folder / "processed_image_params.json").write_text(facts)
    return folder


@pytest.fixture
def copy(recording, tmp_path):
    return Path(shutil.copytree(recording, tmp_path / "copy"))


def test_pictures_come_back_at_the_sensors_scale(recording):
    read = read_tactip_shear(recording, 10)
    wanted = TactileSimulator("tactip", seed=0).reference()
    assert read.current.shape == (10, 480, 640)
    assert (read.reference_from, read.name) == ("free air", "robot/train")
    white, wanted = read.reference > 0, wanted > 0
    assert (white & wanted).sum() > 0.7 * (white | wanted).sum()


def test_the_lightest_contact_stands_in_for_free_air(copy):
    (copy / "processed_images" / "image_0.png").unlink()
    assert read_tactip_shear(copy, 3).reference_from.endswith("mm deep")


@pytest.mark.parametrize("gone", ["processed_image_params.json", "processed_images/image_1.png"])
def test_what_is_missing_is_named(copy, gone):
    (copy / gone).unlink()
    with pytest.raises(DatasetError, match="Copy the recording again"):
        read_tactip_shear(copy, 40)


def test_readouts_find_depth_and_shear(recording, tiny):
    read = read_tactip_shear(recording, 40)
    for features in (latent_features(Tokenizer.random(tiny)), descriptor_features):
        said = fit_readout(features(read), labels_mm(read), 0.1).predict(features(read))
        assert np.corrcoef(said[:, 0], read.depth_mm)[0, 1] > 0.9


def test_a_turned_sensor_is_read_after_its_angle():
    rng = np.random.default_rng(1)
    label = rng.normal(size=(200, 3))
    angle = np.radians(39)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned = np.column_stack([1.5 * label[:, 0] + 0.2, 0.8 * label[:, 1:] @ turn])
    found = transfer((label, label), (turned, label), 0.01)
    assert found["angle_deg"] == pytest.approx(-39, abs=1)
    assert found["as_is"]["shear_r"] < 0.85 and found["one_angle"]["shear_r"] > 0.99
    assert found["few_frames"]["shear_r2"] > 0.95 and found["few_frames"]["depth_r2"] > 0.95


def test_a_picture_that_is_none(tmp_path):
    with pytest.raises(DatasetError, match="picture"):
        marker_image(tmp_path / "none.png", 200.0)
