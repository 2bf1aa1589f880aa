"""A task with the documented keys goes to LeRobot and back; ours goes there; what is damaged is named."""

import importlib
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets.dataset_tools import delete_episodes
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from scipy.spatial.transform import Rotation

from uniforce_cli.convert import main
from uniforce_datasets import zarr_task as store
from uniforce_datasets.lossless import check_dataset, rehash
from uniforce_datasets.open_x_tactile import _pad_key, from_lerobot, to_lerobot, wrist_pose
from uniforce_datasets.source import episode_frames, read_source
from uniforce_datasets.synthetic import record_synthetic
from uniforce_robots.franka.poses import TOOL_TO_EE, ToolPose
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.keys import ACTION, STATE, tactile_key

ENDS = np.array([4, 9])
T, PADS = int(ENDS[-1]), "right_tactile_data_gripper"
INSTRUCTIONS = np.array(["reach the board"] * 2 + ["wipe it".ljust(20)] * 7)  # padded, as FTP-1's parser writes them


@pytest.fixture(scope="module", autouse=True)
def zarr():
    return pytest.importorskip("zarr", reason="the extra oxt isn't installed")


def documented() -> dict[str, np.ndarray]:
    """Return a small array of every kind of documented key."""
    rng = np.random.default_rng(0)
    ramp = np.broadcast_to(np.arange(32, dtype=np.uint8)[:, None] * 7, (32, 32))
    camera = np.stack([np.stack([ramp + t] * 3, axis=-1) for t in range(T)])
    arrays = {
        "timestamps": 1.75e9 + np.arange(T) / 10,
        "camera_main_rgb": camera,
        "camera_ego_rgb": camera[:, ::-1].copy(),
        "right_wrist_camera_rgb": camera,
        "left_wrist_camera_rgb": camera,
        "camera_ego_pose": rng.normal(size=(T, 6)),
        "sub_task_instruction": INSTRUCTIONS,
    }
    for side in ("left", "right"):
        arrays[f"{side}_wrist_pose"] = rng.normal(size=(T, 6)).astype(np.float32)
        arrays[f"{side}_arm_joints"] = rng.normal(size=(T, 7)).astype(np.float32)
        arrays[f"{side}_hand_joints"] = rng.uniform(size=(T, 1))
        arrays[f"{side}_hand_joints_idx"] = np.full((T, 1), 28, np.int32)
        groups = {
            "gripper": (rng.integers(0, 255, (T, 2, 16, 24, 3), dtype=np.uint8), "image"),
            "fingers": (rng.normal(size=(T, 2, 4, 3)).astype(np.float32), "state"),
            "palm": (rng.uniform(size=(T, 2, 1)) > 0.5, "binary"),
        }
        for group, (data, kind) in groups.items():
            arrays[f"{side}_tactile_data_{group}"] = data
            arrays[f"{side}_tactile_area_{group}"] = np.tile(np.array([[0, 1]]), (T, 1))
            arrays[f"{side}_tactile_sensor_{group}"] = np.array(["GelSightMini"] * T)
            arrays[f"{side}_tactile_type_{group}"] = np.array([kind] * T)
    return arrays


def written(folder: Path, arrays: dict[str, np.ndarray]) -> Path:
    """Write a task as FTP-1's parser does: zarr v2, Blosc of lz4 here, chunks along time."""
    zarr, blosc = importlib.import_module("zarr"), importlib.import_module("numcodecs").Blosc("lz4", clevel=5)
    root = zarr.open_group(folder, mode="w", zarr_format=2)
    data = root.create_group("data")
    for key, array in arrays.items():
        data.create_array(key, data=array, chunks=(5, *array.shape[1:]), compressors=blosc)
    root.create_group("meta").create_array("episode_ends", data=ENDS)
    return folder


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("oxt") / "wipe.zarr", documented())


@pytest.fixture(scope="module")
def dataset(task: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return to_lerobot(task, tmp_path_factory.mktemp("lerobot") / "wipe", fps=10)


def test_lerobot_reads_what_was_converted(dataset: Path) -> None:
    loaded = LeRobotDataset("local/wipe", root=dataset)
    assert (loaded.num_episodes, loaded.num_frames, loaded.fps) == (2, T, 10)
    assert loaded[1]["task"] == "reach the board" and loaded[2]["task"] == "wipe it"
    wanted, features = documented(), loaded.meta.features
    assert features[STATE]["names"][6:8] == ["left_arm_joints.0", "left_arm_joints.1"]
    parts = [wanted[key] for key in store.STATES]
    state = np.concatenate(parts, axis=1).astype(np.float32)
    assert np.array_equal(np.stack([loaded[i][STATE] for i in range(T)]), state)
    follows = [1, 2, 3, 3, 5, 6, 7, 8, 8]  # an episode's last frame follows itself
    assert np.array_equal(np.stack([loaded[i][ACTION] for i in range(T)]), state[follows])
    pad = (255 * loaded[5][_pad_key(PADS, 1)]).round().numpy().transpose(1, 2, 0)
    assert np.array_equal(pad, wanted[PADS][5, 1])


def test_there_and_back_every_array_is_the_same_but_for_the_cameras_video(task: Path, dataset: Path, tmp_path: Path):
    back = store.open_task(from_lerobot(dataset, tmp_path / "back.zarr"))
    wanted = documented()
    assert back.arrays.keys() == wanted.keys() and back.ends == ENDS.tolist()
    for key, values in wanted.items():
        came = back.read(key, 0, T)
        assert came.dtype == values.dtype and came.shape == values.shape, key
        if key in store.CAMERAS:
            assert np.abs(came.astype(int) - values).mean() < 4
        else:
            assert np.array_equal(came, values), key
    check_dataset(dataset, "full")  # hashes and all


def test_what_lerobots_tools_leave_goes_back(dataset: Path, tmp_path: Path) -> None:
    delete_episodes(LeRobotDataset("local/wipe", root=dataset), [0], tmp_path / "fewer", "local/fewer")
    rehash(tmp_path / "fewer")
    back = store.open_task(from_lerobot(tmp_path / "fewer", tmp_path / "fewer.zarr"))
    assert back.ends == [5] and np.array_equal(back.read(PADS, 0, 5), documented()[PADS][4:])


@pytest.mark.slow
def test_a_recording_of_ours_becomes_a_task(tmp_path: Path) -> None:
    demos = record_synthetic(tmp_path / "demos", 2, 4)
    assert main([f"dataset={demos}", f"out={tmp_path / 'ours.zarr'}"]) == 0
    ours, source = store.open_task(tmp_path / "ours.zarr"), read_source(demos)
    assert ours.ends == [4, 8]
    episode = source.episodes[1]
    for area, finger in enumerate(("left", "right")):
        pads = ours.read(f"right_tactile_data_gripper_{finger}", 4, 8)
        frames = list(episode_frames(episode.videos[tactile_key(finger)], 4, source.fps))
        assert np.array_equal(pads[:, 0], frames) and set(np.unique(pads)) == {0, 255}
        assert (ours.read(f"right_tactile_area_gripper_{finger}", 0, 8) == area).all()
    assert ours.read("right_tactile_sensor_gripper_right", 0, 1)[0] == "tactip_markers"
    assert ours.read("sub_task_instruction", 7, 8)[0] == source.episodes[1].task
    again = LeRobotDataset("local/again", root=to_lerobot(tmp_path / "ours.zarr", tmp_path / "again", fps=30))
    assert again.num_frames == 8
    state = source.columns((STATE,))[STATE]
    assert np.allclose(np.stack([again[i][STATE] for i in range(8)])[:, [0, 1, 2, 6]], state[:, [0, 1, 2, 4]])


def test_the_hands_axes_are_the_formats() -> None:
    """Z where the hand points, y towards the left finger: against minus the closing axis of the tool."""
    for yaw in (-0.5, 0.0, 0.3, 2.0):
        pose = wrist_pose(np.array([[0.4, 0.1, 0.2, yaw, 0.05]]))[0]
        tool = ToolPose(np.zeros(3), yaw).ee_to_base()[:3, :3] @ TOOL_TO_EE
        turn = Rotation.from_rotvec(pose[3:]).as_matrix()
        assert np.allclose(turn[:, 2], tool[:, 2]) and np.allclose(turn[:, 1], -tool[:, 0])
        assert np.allclose(pose[:3], [0.4, 0.1, 0.2])


def without(key: str):
    return lambda folder: shutil.rmtree(folder / "data" / key)


def array_settings(key: str, **changed: object):
    def change(folder: Path) -> None:
        file = folder / "data" / key / ".zarray"
        file.write_text(json.dumps(json.loads(file.read_text()) | changed))

    return change


DAMAGES = {
    "no task": (lambda folder: shutil.rmtree(folder), "a zarr v2 group"),
    "no instruction": (without("sub_task_instruction"), "expected sub_task_instruction"),
    "no time": (without("timestamps"), "expected timestamps"),
    "no area": (without("left_tactile_area_palm"), "expected left_tactile_area_palm"),
    "no slots": (without("right_hand_joints_idx"), "expected right_hand_joints_idx"),
    "no ends": (lambda folder: shutil.rmtree(folder / "meta"), "episode_ends"),
    "short": (array_settings("timestamps", shape=[8]), "expected 9 frames"),
    "cut chunk": (lambda folder: (folder / f"data/{PADS}/1.0.0.0.0").write_bytes(b"cut"), "frames 4 … 9"),
    "lost picture": (lambda folder: (folder / "data/camera_main_rgb/1.0.0.0").unlink(), "1 of 2 chunks"),
    "settings cut": (lambda folder: (folder / "data/timestamps/.zarray").write_text('{"sha'), "JSON"),
    "settings bare": (lambda folder: (folder / "data/timestamps/.zarray").write_text("{}"), "a whole zarr v2 array"),
    "no known codec": (array_settings("timestamps", compressor={"id": "pickle"}), "none but"),
    "flat pictures": (array_settings("camera_ego_rgb", shape=[9, 96, 32], chunks=[5, 96, 32]), "(T, H, W, 3)"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_named_in_one_line_and_nothing_is_left(damage: str, task: Path, tmp_path: Path, capsys) -> None:
    injure, said = DAMAGES[damage]
    shutil.copytree(task, tmp_path / "bad.zarr")
    injure(tmp_path / "bad.zarr")
    (tmp_path / "bad.zarr").mkdir(exist_ok=True)
    assert main([f"dataset={tmp_path / 'bad.zarr'}", f"out={tmp_path / 'out'}", "fps=10"]) == 2
    said_last = capsys.readouterr().err.splitlines()[-1]  # above it: what Hugging Face counts
    assert said_last.startswith("uniforce convert: ") and said in said_last and "expected" in said_last
    assert [path.name for path in tmp_path.iterdir()] == ["bad.zarr"]


def test_ends_that_are_none_links_and_taken_names_are_refused(task: Path, dataset: Path, tmp_path: Path) -> None:
    for ends in ([4, 4, 9], [1, 9], [9, 4]):
        bad = shutil.copytree(task, tmp_path / "bad.zarr", dirs_exist_ok=True)
        importlib.import_module("zarr").open_group(bad, mode="r+")["meta"].create_array(
            "episode_ends", data=np.array(ends), overwrite=True
        )
        with pytest.raises(DatasetError, match="two frames apart"):
            store.open_task(bad)
    (bad / "data" / "elsewhere").symlink_to("/etc")
    with pytest.raises(DatasetError, match="a path inside"):
        store.open_task(bad)
    with pytest.raises(DatasetError, match="a new folder"):
        to_lerobot(task, dataset, fps=10)


def test_another_dataset_and_no_zarr_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    demos = record_synthetic(tmp_path / "demos", 1, 2)
    other = shutil.copytree(demos, tmp_path / "other")
    info = json.loads((other / "meta" / "info.json").read_text())
    info["features"][STATE]["names"] = list("abcde")
    (other / "meta" / "info.json").write_text(json.dumps(info))
    (other / "hashes.json").unlink()
    with pytest.raises(DatasetError, match="or the state"):
        from_lerobot(other, tmp_path / "other.zarr")
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(DatasetError, match=r"pip install '\.\[oxt\]'"):
        from_lerobot(demos, tmp_path / "ours.zarr")
    assert not (tmp_path / "ours.zarr").exists()
