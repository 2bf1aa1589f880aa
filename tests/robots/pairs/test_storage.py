"""Kept pairs: both forms hold the same images, and survive whatever stops the recorder."""

import shutil

import numpy as np
import pytest

from uniforce_datasets.readers.uniforce_pairs import PairConfig, bordered, read_uniforce_pairs
from uniforce_datasets.source import episode_frames, read_source
from uniforce_robots.pairs.storage import PairStore
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import ContractError, DatasetError
from uniforce_vtla.keys import PAIR_ERROR, pair_force_key, tactile_key

NAMES = ("sphere", "line")


def opened(root, left_sensor="gelsight", indenters=NAMES, rate_hz=15):
    return PairStore(root, left_sensor, "tactip", indenters, rate_hz)


def layout(root):
    found = read_uniforce_pairs(root / "uniforce_pairs", PairConfig())
    return {f"{r.name}/{r.indenter}": (r.left_frames, r.right_frames) for r in found}


def test_both_forms_give_the_images_back(tmp_path, make_chunk):
    chunk = make_chunk(n=4)
    pairs = chunk[2]
    with opened(tmp_path) as store:
        store.add(*chunk)
        assert store.counts.tolist() == [4, 0] and store.coverage[0].force.sum() == 4
    [(left, right)] = layout(tmp_path).values()
    images = {finger: np.stack([pair.frame.images[finger] for pair in pairs]) for finger in FINGERS}
    assert np.array_equal(left, bordered(images["left"]))
    assert np.array_equal(right, bordered(images["right"]))
    source = read_source(tmp_path / "lerobot")
    for finger in FINGERS:
        stored = list(episode_frames(source.episodes[0].videos[tactile_key(finger)], 4, 15))
        assert np.array_equal(np.stack(stored)[..., 0], images[finger])
        column = pair_force_key(finger)
        force_N = [pair.force_N[finger] for pair in pairs]
        assert np.allclose(source.columns((column,))[column], force_N, atol=1e-5)
    stored_error = source.columns((PAIR_ERROR,))[PAIR_ERROR].ravel()
    assert np.allclose(stored_error, [pair.error for pair in pairs], atol=1e-6)


def test_it_goes_on_where_it_stopped(tmp_path, make_chunk):
    with opened(tmp_path) as store:
        store.add(*make_chunk(0, 0, 3))
        store.add(*make_chunk(1, 0, 2, seed=5))
    with opened(tmp_path) as store:
        assert store.counts.tolist() == [3, 2] and store.next_session == 1
        assert [c.force.sum() for c in store.coverage] == [3, 2]
        store.add(*make_chunk(0, 1, 2, seed=9))  # new references: another session folder
    spheres = {name: len(pair[0]) for name, pair in layout(tmp_path).items() if "sphere" in name}
    folder = "uniforce/session_{}/gelsight_tactip/sphere"
    assert spheres == {folder.format("000"): 3, folder.format("001"): 2}


@pytest.mark.parametrize("damage", ["behind", "half a pair", "ahead", "gone"])
def test_a_layout_a_kill_left_wrong_is_mended_from_the_dataset(tmp_path, make_chunk, damage):
    with opened(tmp_path) as store:
        store.add(*make_chunk(n=3))
        store.add(*make_chunk(n=3, seed=7))
    wanted = layout(tmp_path)
    images = sorted((tmp_path / "uniforce_pairs").rglob("[0-9]*.jpg"))
    last = [image for image in images if image.stem == "000005"]
    behind = [image for image in images if int(image.stem) >= 2]
    if damage == "ahead":
        for image in last:
            shutil.copy(image, image.with_name("000006.jpg"))
    else:
        for image in {"gone": images, "behind": behind, "half a pair": images[-1:]}[damage]:
            image.unlink()
    opened(tmp_path).close()
    found = layout(tmp_path)
    assert found.keys() == wanted.keys()
    for name, pair in wanted.items():
        assert all(np.array_equal(a, b) for a, b in zip(pair, found[name], strict=True))


def test_two_sensors_of_one_kind_are_kept_apart(tmp_path, make_chunk):
    with opened(tmp_path, left_sensor="tactip") as store:
        store.add(*make_chunk())
    assert list(layout(tmp_path)) == ["uniforce/session_000/tactip_l_tactip_r/sphere"]


@pytest.mark.parametrize("names", [("bar", "line"), ("line", "sphere")])
def test_another_object_is_not_recorded_under_the_same_number(names, tmp_path, make_chunk):
    with opened(tmp_path, indenters=("sphere", "line")) as store:
        store.add(*make_chunk(0, 0, 3))
    with pytest.raises(DatasetError, match=r"hold the (bar|line), got hold the sphere"):
        opened(tmp_path, indenters=names)


def test_what_does_not_fit_is_refused(tmp_path, make_chunk):
    with opened(tmp_path) as store:
        with pytest.raises(ContractError, match="indenter 2"):
            store.add(*make_chunk(indenter=2))
        with pytest.raises(ContractError, match="1 pairs"):
            store.add(*make_chunk(n=1))
        store.add(*make_chunk(indenter=1))
        with pytest.raises(DatasetError, match="one recorder"):
            opened(tmp_path)
    with pytest.raises(DatasetError, match="indenters"):
        opened(tmp_path, indenters=("sphere",))
    with pytest.raises(DatasetError, match="fps"):
        opened(tmp_path, rate_hz=30)
