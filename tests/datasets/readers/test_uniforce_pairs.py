import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from benchmarks.trust.injuries import cut
from uniforce_datasets.readers import (
    PairConfig,
    PairRecording,
    read_uniforce_pairs,
    write_uniforce_pairs,
)
from uniforce_datasets.readers.uniforce_pairs import bordered
from uniforce_vtla.errors import ContractError, DatasetError


def pairs_of(left, right, indenter="sphere"):
    images = left.reference, right.reference, left.frames, right.frames
    return PairRecording((left.sensor, right.sensor), indenter, "p", *images)


@pytest.fixture
def recorded(tmp_path, marker_trials):
    """Six pairs each of two indenters, GelSight-D left and TacTip right."""
    for indenter in ("moon", "sphere"):
        pairs = pairs_of(marker_trials[0], marker_trials[2], indenter)
        named = replace(pairs, sensors=("gelsight_d", "tactip"))
        write_uniforce_pairs(tmp_path / "pairs", named, "Diamond1", "20260131")
    return tmp_path / "pairs"


def folder(root):
    return root / "Diamond1" / "20260131" / "gelsight_d_tactip"


def test_what_is_written_is_read_back(recorded, marker_trials):
    found = list(read_uniforce_pairs(recorded))
    assert [r.indenter for r in found] == ["moon", "sphere"]
    left, _, right, *_ = marker_trials
    for pairs in found:
        assert pairs.sensors == ("gelsight_d", "tactip")
        assert np.array_equal(pairs.left_reference, bordered(left.reference))
        assert np.array_equal(pairs.right_reference, bordered(right.reference))
    assert (folder(recorded) / "collection_log.txt").read_text().count("6 pairs from 000000") == 2
    images = sorted(p.name for p in (folder(recorded) / "marker" / "tactip" / "moon").iterdir())
    assert images[:2] == ["000000.jpg", "000001.jpg"]


@examples(8)
@given(seed=st.integers(0, 2**32 - 1), split=st.integers(1, 3), cell=st.sampled_from([1, 3, 8, 40]))
def test_any_binary_image_survives(tmp_path_factory, seed, split, cell):
    """Blocks of any size, single pixels included, written in two goes."""
    rng = np.random.default_rng(seed)
    coarse = (rng.random((2, 5, 480 // cell + 1, 640 // cell + 1)) > 0.5) * np.uint8(255)
    left, right = coarse.repeat(cell, axis=2).repeat(cell, axis=3)[..., :480, :640]
    root = tmp_path_factory.mktemp("any")
    for rows in (slice(0, split), slice(split, 4)):
        part = PairRecording(("a", "b_c"), "cone", "p", left[4], right[4], left[rows], right[rows])
        write_uniforce_pairs(root, part, "any", "d")
    (read,) = read_uniforce_pairs(root)
    assert np.array_equal(read.left_frames, bordered(left[:4]))
    assert np.array_equal(read.right_frames, bordered(right[:4]))
    assert read.sensors == ("a", "b_c")


def test_many_pairs_come_in_parts(recorded):
    parts = list(read_uniforce_pairs(recorded, PairConfig(indenters=("moon",), max_frames=4)))
    assert [(p.first_frame, len(p.left_frames)) for p in parts] == [(0, 4), (4, 2)]


def test_a_reference_frame_must_be_named(recorded, marker_trials):
    for path in recorded.rglob("reference.jpg"):
        path.unlink()
    with pytest.raises(DatasetError, match=r"reference\.jpg.*reference_index=0"):
        list(read_uniforce_pairs(recorded))
    found = next(read_uniforce_pairs(recorded, PairConfig(reference_index=1)))
    assert np.array_equal(found.left_reference, bordered(marker_trials[0].frames[1]))
    with pytest.raises(DatasetError, match="frame 000044"):
        list(read_uniforce_pairs(recorded, PairConfig(reference_index=44)))


def test_one_reference_per_sensor_serves_all_indenters(recorded):
    sensor = folder(recorded) / "marker" / "tactip"
    shutil.copy(sensor / "moon" / "reference.jpg", sensor / "reference.jpg")
    for indenter in ("moon", "sphere"):
        (sensor / indenter / "reference.jpg").unlink()
    assert len(list(read_uniforce_pairs(recorded))) == 2


def test_unknown_indenter_lists_those_there(recorded):
    with pytest.raises(DatasetError, match=r"moon \| sphere"):
        list(read_uniforce_pairs(recorded, PairConfig(indenters=("cone",))))


# -- what can be wrong -----------------------------------------------------------------------------


def side(root, sensor="tactip"):
    return folder(root) / "marker" / sensor / "sphere"


def picture(path, value, *shape):
    cv2.imwrite(str(path), np.full(shape, value, np.uint8))


def no_images(root):
    for path in folder(root).glob("marker/*/sphere/0*.jpg"):
        path.unlink()


def linked(root, path):
    path.rename(root.parent / "elsewhere.jpg")
    path.symlink_to(root.parent / "elsewhere.jpg")


BROKEN = {
    "one missing": (lambda r: (side(r) / "000003.jpg").unlink(), "1 on one side only, e.g. 000003"),
    "truncated": (lambda r: cut(side(r) / "000003.jpg"), "truncated"),
    "size": (
        lambda r: picture(side(r) / "000003.jpg", 0, 100, 100),
        r"\(480, 640\), got \(100, 100\)",
    ),
    "raw picture": (lambda r: picture(side(r) / "000003.jpg", 128, 480, 640), "black and white"),
    "other sensor": (
        lambda r: side(r).parent.rename(folder(r) / "marker" / "digit"),
        r"two sensors of gelsight_d_tactip.*digit",
    ),
    "one side only": (lambda r: shutil.rmtree(side(r)), "the same indenters on both sides"),
    "no images": (no_images, "got none"),
    "linked image": (lambda r: linked(r, side(r) / "000003.jpg"), "a path inside"),
    "linked reference": (lambda r: linked(r, side(r) / "reference.jpg"), "a path inside"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_pairs_are_refused(recorded, name):
    damage, says = BROKEN[name]
    damage(recorded)
    with pytest.raises(DatasetError, match=says):
        list(read_uniforce_pairs(recorded))


def test_folders_without_pairs_are_refused(tmp_path):
    with pytest.raises(DatasetError, match=r"collection_log\.txt"):
        list(read_uniforce_pairs(tmp_path))


@pytest.mark.parametrize("name", ["../up", "a/b", "", ".hidden", "__x"])
def test_names_that_are_no_folders_are_refused(tmp_path, marker_trials, name):
    left, _, right, *_ = marker_trials
    for indenter, pattern in ((name, "p"), ("sphere", name)):
        with pytest.raises(ContractError, match="plain name"):
            write_uniforce_pairs(tmp_path, pairs_of(left, right, indenter), pattern, "d")
    assert not list(tmp_path.iterdir())


def test_writer_refuses_what_it_could_not_read_back(tmp_path, marker_trials):
    gelsight, same, tactip, *_ = marker_trials
    with pytest.raises(ContractError, match="two different names"):
        write_uniforce_pairs(tmp_path, pairs_of(gelsight, same), "p", "d")
    small = np.zeros((48, 64), np.uint8)
    pairs = PairRecording(("a", "b"), "cone", "p", small, small, small[None], small[None])
    with pytest.raises(ContractError, match="pair images"):
        write_uniforce_pairs(tmp_path, pairs, "p", "d")
    pairs = pairs_of(gelsight, tactip)
    write_uniforce_pairs(tmp_path, pairs, "p", "d")
    moved = replace(pairs, left_reference=gelsight.frames[-1])
    with pytest.raises(DatasetError, match="the reference of this recording"):
        write_uniforce_pairs(tmp_path, moved, "p", "d")


def test_date_is_today_where_none_is_given(tmp_path, marker_trials):
    written = write_uniforce_pairs(tmp_path, pairs_of(marker_trials[0], marker_trials[2]), "Array1")
    assert written.parent.parent == tmp_path / "Array1" and len(written.parent.name) == 8
