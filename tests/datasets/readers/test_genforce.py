import shutil
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmarks.trust.injuries import cut
from uniforce_datasets.readers import (
    ForceAxes,
    GenForceConfig,
    LabelledRecording,
    PairRecording,
    ReadOptions,
    read_genforce,
)
from uniforce_datasets.readers.genforce import check_compression, read_packed
from uniforce_vtla.errors import ContractError, DatasetError


def hetero(release):
    return release / "dataset" / "training" / "hetero"


def image_folder(release, sensor="gelsight"):
    return hetero(release) / "img" / sensor / "sphere" / "1"


def force_file(release):
    return hetero(release) / "force" / "gelsight" / "sphere" / "1" / "ft.csv"


def edit_forces(release, edit):
    edit(pd.read_csv(force_file(release))).to_csv(force_file(release), index=False)


@pytest.mark.parametrize("below", ["", "dataset/training/hetero"])
def test_images_and_forces_come_back_exactly(genforce, marker_trials, below):
    found = {(r.sensor, r.indenter): r for r in read_genforce(genforce / below)}
    assert len(found) == len(marker_trials) == 6
    for trial in marker_trials:
        recording = found[trial.sensor, trial.indenter]
        assert np.array_equal(recording.frames, trial.frames)
        assert np.array_equal(recording.reference, trial.frames[0])
        # Fz was written negative: z comes out positive
        assert np.array_equal(recording.force_N, trial.force_N)
        assert (recording.trial, recording.first_frame) == ("1", 0)
    assert max(r.force_N[:, 2].max() for r in found.values()) > 0.5


def test_splits_and_sensors(genforce):
    unseen = GenForceConfig(sensors=("tactip",), split="unseen")
    assert [str(r) for r in read_genforce(genforce, unseen)] == ["tactip/wave/1"]
    assert {r.indenter for r in read_genforce(genforce, GenForceConfig(split="seen"))} == {"sphere"}
    with pytest.raises(ContractError, match="split"):
        list(read_genforce(genforce, GenForceConfig(split="some")))


def test_unknown_sensor_lists_those_there(genforce):
    with pytest.raises(DatasetError, match=r"gelsight \| tactip \| uskin.*digit"):
        list(read_genforce(genforce, GenForceConfig(sensors=("digit",))))


def read_sphere(release, z="-z", **options):
    """Read the trial of a GelSight and a sphere."""
    config = GenForceConfig(("gelsight",), "seen", ForceAxes(z=z), ReadOptions(**options))
    return list(read_genforce(release, config))


def test_a_long_trial_comes_in_parts(genforce, marker_trials):
    first, second = read_sphere(genforce, max_frames=4)
    assert (first.first_frame, second.first_frame) == (0, 4)
    assert np.array_equal(np.concatenate([first.frames, second.frames]), marker_trials[0].frames)
    assert np.array_equal(np.concatenate([first.force_N, second.force_N]), marker_trials[0].force_N)


def test_plain_arrays_are_read_too(tmp_path, marker_trials):
    image = marker_trials[0].frames[1]
    for number, array in enumerate([image, image // 255, image > 0]):
        np.save(tmp_path / f"{number}.npy", array)
        assert np.array_equal(read_packed(tmp_path / f"{number}.npy"), image)


# -- what can be wrong -----------------------------------------------------------------------------


def frame(release, sensor="gelsight"):
    return image_folder(release, sensor) / ("0002.jpg" if sensor == "uskin" else "0002.npy")


def save(release, array):
    np.save(frame(release), array)


def picture(release, value, shape=(480, 640)):
    cv2.imwrite(str(frame(release, "uskin")), np.full(shape, value, np.uint8))


def archive(release):
    with frame(release).open("wb") as stream:
        np.savez(stream, a=np.zeros(3))


def no_frames(release):
    for path in image_folder(release).glob("*.npy"):
        path.unlink()


def pressed_from_the_start(release):
    edit_forces(release, lambda table: table - [0, 0, 1.0, 0, 0, 0])


def set_z(release, z_N):
    edit_forces(release, lambda table: 0 * table + np.outer(z_N, [0, 0, 1, 0, 0, 0]))


def wrong_sign(release):
    set_z(release, np.linspace(0, 8, 6))


def linked(release, path):
    shutil.move(path, release.parent / "elsewhere")
    path.symlink_to(release.parent / "elsewhere")


BROKEN = {
    "truncated": (lambda r: cut(frame(r)), r"0002\.npy.*whole \.npy"),
    "an archive": (archive, r"one array.*an archive"),
    "another size": (lambda r: save(r, np.zeros(9600, np.uint8)), r"38400 packed bytes"),
    "grey values": (lambda r: save(r, np.full((480, 640), 7, np.uint8)), r"38400 packed bytes"),
    "small jpeg": (lambda r: picture(r, 0, (240, 320)), r"480, 640.*240, 320"),
    "grey jpeg": (lambda r: picture(r, 120), r"black and white"),
    "half a jpeg": (lambda r: cut(frame(r, "uskin")), r"truncated"),
    "no csv": (lambda r: force_file(r).unlink(), r"ft\.csv: expected a csv file"),
    "empty csv": (lambda r: cut(force_file(r), 0), r"ft\.csv: expected a csv table"),
    "few rows": (
        lambda r: edit_forces(r, lambda table: table[:-1]),
        r"6 rows, one per image, got 5",
    ),
    "few columns": (lambda r: edit_forces(r, lambda table: table.iloc[:, :2]), r"three columns"),
    "NaN": (lambda r: edit_forces(r, lambda table: table.shift()), r"finite forces"),
    "text": (
        lambda r: edit_forces(r, lambda table: table.shift().fillna("none")),
        r"finite forces",
    ),
    "missing frame": (lambda r: frame(r).unlink(), r"5 rows, one per image, got 6"),
    "two kinds": (lambda r: (image_folder(r) / "0009.jpg").touch(), r"one kind"),
    "no frames": (no_frames, r"got none"),
    "pressed": (pressed_from_the_start, r"gelsight/sphere/1.*free-air frame.*1\.00 N"),
    "wrong sign": (wrong_sign, r"8\.0 N of pull"),
    "linked frame": (lambda r: linked(r, frame(r)), r"a path inside"),
    "linked forces": (lambda r: linked(r, force_file(r)), r"a path inside"),
    "linked folder": (lambda r: linked(r, image_folder(r)), r"a path inside"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_sets_are_refused(genforce, name):
    damage, says = BROKEN[name]
    damage(genforce)
    with pytest.raises(DatasetError, match=says):
        list(read_genforce(genforce))


def test_a_pressed_trial_can_be_left_out_by_choice(genforce):
    pressed_from_the_start(genforce)
    options = ReadOptions(pressed_reference="skip")
    read = [str(r) for r in read_genforce(genforce, GenForceConfig(options=options))]
    assert len(read) == 5 and "gelsight/sphere/1" not in read


def test_the_quietest_frame_can_be_the_reference(genforce, marker_trials):
    set_z(genforce, [-3.0, -2.0, 0.0, -2.0, -3.0, -3.0])
    (recording,) = read_sphere(genforce, reference="quietest")
    assert np.array_equal(recording.reference, marker_trials[0].frames[2])


def test_a_wrong_sign_can_be_turned(genforce):
    wrong_sign(genforce)
    (recording,) = read_sphere(genforce, z="+z")
    assert recording.force_N[-1, 2] == 8.0


def test_folders_without_the_layout_are_refused(tmp_path):
    (tmp_path / "readme.txt").touch()
    with pytest.raises(DatasetError, match=r"img/ and force/"):
        list(read_genforce(tmp_path))
    with pytest.raises(DatasetError, match="a folder"):
        list(read_genforce(tmp_path / "absent"))


IMAGE = np.zeros((48, 64), np.uint8)


@pytest.mark.parametrize(
    "changes",
    [
        {"frames": np.zeros((0, 48, 64), np.uint8)},
        {"frames": np.zeros((3, 48, 60), np.uint8)},
        {"frames": np.full((3, 48, 64), 128, np.uint8)},
        {"frames": np.zeros((3, 48, 64), np.float32)},
        {"reference": np.full((48, 64), 1, np.uint8)},
        {"force_N": np.zeros((2, 3), np.float32)},
        {"force_N": np.zeros((3, 3), np.float64)},
        {"force_N": np.full((3, 3), np.nan, np.float32)},
    ],
)
def test_a_recording_outside_the_form_is_refused(changes):
    frames = np.stack([IMAGE] * 3)
    whole = LabelledRecording("g", "cone", "1", IMAGE, frames, np.zeros((3, 3), np.float32))
    with pytest.raises(DatasetError, match="g/cone/1"):
        replace(whole, **changes)


def test_pairs_of_different_length_are_refused():
    two, three = np.stack([IMAGE] * 2), np.stack([IMAGE] * 3)
    with pytest.raises(DatasetError, match="as many left as right"):
        PairRecording(("g", "t"), "cone", "p", IMAGE, IMAGE, two, three)


def test_axes_are_a_signed_permutation():
    recorded = np.array([[1.0, 2.0, -3.0, 99.0, 99.0, 99.0]])
    assert ForceAxes().to_image(recorded).tolist() == [[1.0, 2.0, 3.0]]
    assert ForceAxes("-y", "+x", "-z").to_image(recorded).tolist() == [[-2.0, 1.0, 3.0]]


@pytest.mark.parametrize("axes", [("+x", "+x", "+z"), ("x", "+y", "-z")])
def test_axes_that_are_none_are_refused(axes):
    with pytest.raises(ContractError, match="force axes"):
        ForceAxes(*axes)


def test_drift_and_a_gel_that_sticks_are_no_wrong_sign():
    check_compression(np.array([[0, 0, -1.5], [0, 0, 0.2]]), "drift")
    check_compression(np.array([[0, 0, -2.5], [0, 0, 9.0]]), "sticky release")
