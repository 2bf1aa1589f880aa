from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from uniforce_datasets.readers import ForceAxes, ReadOptions, TafConfig, force_set, read_taf_lerobot
from uniforce_datasets.readers.taf import tactile_column
from uniforce_vtla import Canonicalizer
from uniforce_vtla.errors import DatasetError, SensorError

GEL, WRENCH = "observation.images.tactile", "observation.wrench"
FPS = 30


def write_lerobot(
    root: Path, frames: np.ndarray, force_N: np.ndarray, dtype: str = "video", episodes: int = 2
) -> Path:
    """Write a LeRobot v3 dataset by hand: every episode has the same frames."""
    length, (height, width) = len(frames), frames.shape[1:3]
    (root / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
    (root / "data" / "chunk-000").mkdir(parents=True)
    features: dict[str, Any] = {
        GEL: {"dtype": dtype, "shape": [height, width, 3]},
        "observation.images.scene": {"dtype": dtype, "shape": [height, width, 3]},
        WRENCH: {"dtype": "float32", "shape": [6], "names": ["fx", "fy", "fz", "tx", "ty", "tz"]},
        "observation.state": {"dtype": "float32", "shape": [6]},
        "pressure_map": {"dtype": "float32", "shape": [144]},
    }
    info = {
        "codebase_version": "v3.0",
        "fps": FPS,
        "total_episodes": episodes,
        "total_frames": episodes * length,
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": features,
    }
    (root / "meta" / "info.json").write_text(json.dumps(info))
    recorded = np.hstack([force_N * (1, 1, -1), np.full((length, 3), 0.5)]).astype(
        np.float32
    )  # Fz < 0 pressed
    columns: dict[str, Any] = {
        "index": np.arange(episodes * length),
        "episode_index": np.repeat(np.arange(episodes), length),
        WRENCH: list(np.tile(recorded, (episodes, 1))),
        "observation.state": list(np.zeros((episodes * length, 6), np.float32)),
    }
    if dtype == "image":
        columns[GEL] = [{"bytes": _png(frame), "path": None} for frame in frames] * episodes
    else:
        _write_video(
            root / info["video_path"].format(video_key=GEL, chunk_index=0, file_index=0), frames, episodes
        )
    pq.write_table(pa.table(columns), root / "data" / "chunk-000" / "file-000.parquet")
    rows: dict[str, Any] = {
        "episode_index": range(episodes),
        "dataset_from_index": [e * length for e in range(episodes)],
        "length": [length] * episodes,
        "tasks": [["press"]] * episodes,
    }
    for key in (GEL, "observation.images.scene") if dtype == "video" else ():
        rows[f"videos/{key}/chunk_index"] = rows[f"videos/{key}/file_index"] = [0] * episodes
        rows[f"videos/{key}/from_timestamp"] = [e * length / FPS for e in range(episodes)]
    table = pa.table({key: list(values) for key, values in rows.items()})
    pq.write_table(table, root / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    return root


def without_markers(frame: np.ndarray) -> np.ndarray:
    small = cv2.resize(frame, (16, 12), interpolation=cv2.INTER_AREA)
    return cv2.resize(small, frame.shape[1::-1], interpolation=cv2.INTER_CUBIC)


def _png(frame: np.ndarray) -> bytes:
    return cv2.imencode(".png", frame[..., ::-1])[1].tobytes()


def _write_video(path: Path, frames: np.ndarray, times: int) -> None:
    path.parent.mkdir(parents=True)
    with av.open(str(path), "w") as video:
        stream = video.add_stream(
            "libx264rgb", FPS, options={"crf": "0", "preset": "ultrafast"}
        )  # exact in RGB
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], "rgb24"
        for frame in np.concatenate([frames] * times):
            video.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        video.mux(stream.encode())


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, gel_run: Any) -> Path:
    return write_lerobot(tmp_path_factory.mktemp("lerobot") / "cube", gel_run.raw, gel_run.force_N)


@pytest.fixture
def lerobot(tmp_path: Path, written: Path) -> Path:
    return shutil.copytree(written, tmp_path / "gs_mini" / "cube")


@pytest.mark.parametrize("dtype", ["video", "image"])
def test_frames_and_forces_come_back(tmp_path: Path, written: Path, gel_run: Any, dtype: str) -> None:
    if dtype == "video":
        shutil.copytree(written, tmp_path / "gs_mini" / "cube")
    else:
        write_lerobot(tmp_path / "gs_mini" / "cube", gel_run.raw, gel_run.force_N, dtype)
    found = force_set(tmp_path)
    recordings = list(found)
    assert found.format == "taf_lerobot"
    assert [str(r) for r in recordings] == [f"gelsight_mini/cube/episode_00000{i}" for i in range(2)]
    pairs = [Canonicalizer("gelsight").pair(gel_run.raw[0], raw, "left") for raw in gel_run.raw]
    for recording in recordings:
        assert np.array_equal(recording.reference, pairs[0].reference)
        assert np.array_equal(recording.frames, np.stack([pair.current for pair in pairs]))
        assert np.array_equal(recording.force_N, gel_run.force_N)  # recorded Fz was negative in compression
    assert (recordings[0].frames[0] > 0).mean() > 0.01


def test_a_long_episode_comes_in_parts(lerobot: Path, gel_run: Any) -> None:
    parts = list(read_taf_lerobot(lerobot, TafConfig(options=ReadOptions(max_frames=4))))
    assert [(p.trial, p.first_frame, len(p.frames)) for p in parts[:2]] == [
        ("episode_000000", 0, 4),
        ("episode_000000", 4, 2),
    ]
    assert np.array_equal(parts[1].force_N, gel_run.force_N[4:])


def edit_info(root: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    path = root / "meta" / "info.json"
    info = json.loads(path.read_text())
    edit(info)
    path.write_text(json.dumps(info))


def rename(old: str, new: str) -> Callable[[dict[str, Any]], None]:
    def edit(info: dict[str, Any]) -> None:
        info["features"][new] = info["features"].pop(old)

    return edit


def test_unclear_columns_are_listed(lerobot: Path) -> None:
    with pytest.raises(DatasetError, match=r"tactile_key.*observation\.images\.scene.*observation\.wrench"):
        list(read_taf_lerobot(lerobot, TafConfig(tactile_key="observation.images.gel")))
    with pytest.raises(DatasetError, match=r"wrench_key.*pressure_map \(float32 \[144\]\)"):
        list(read_taf_lerobot(lerobot, TafConfig(wrench_key="pressure_map")))
    with pytest.raises(DatasetError, match=r"wrench_key.*observation\.left_hand"):
        edit_info(lerobot, rename(WRENCH, "observation.left_hand"))  # "ft" is not looked for inside words
        list(read_taf_lerobot(lerobot))


def test_two_tactile_columns_are_not_chosen_between() -> None:
    picture = {"dtype": "video", "shape": [480, 640, 3]}
    features = {f"{GEL}_left": picture, f"{GEL}_right": picture, "observation.images.gelsight": picture}
    with pytest.raises(DatasetError, match=r"tactile_left.*tactile_right"):
        tactile_column(features, TafConfig())
    assert tactile_column(features, TafConfig(tactile_key=f"{GEL}_right")) == f"{GEL}_right"
    assert tactile_column(features, TafConfig(tactile_words=("gelsight",))) == "observation.images.gelsight"


def test_other_axes(lerobot: Path, gel_run: Any) -> None:
    (first, _) = read_taf_lerobot(lerobot, TafConfig(axes=ForceAxes("-y", "+x", "-z")))
    assert np.array_equal(first.force_N[:, 0], -gel_run.force_N[:, 1])
    with pytest.raises(DatasetError, match=r"5\.0 N of pull"):
        list(read_taf_lerobot(lerobot, TafConfig(axes=ForceAxes(z="+z"))))


def test_a_gel_without_markers_raises_the_canonicalisers_error(tmp_path: Path, gel_run: Any) -> None:
    smooth = np.stack([without_markers(frame) for frame in gel_run.raw[:3]])
    root = write_lerobot(tmp_path / "gs_mini" / "cube", smooth, gel_run.force_N[:3], "image", episodes=1)
    with pytest.raises(SensorError, match="markers on the gel") as caught:
        list(read_taf_lerobot(root))
    assert caught.value.__notes__ == ["in frame 0 of gelsight_mini/cube/episode_000000"]


def test_an_unreadable_frame_can_end_a_recording_by_choice(tmp_path: Path, gel_run: Any) -> None:
    frames = gel_run.raw.copy()
    frames[3] = without_markers(frames[3])
    root = write_lerobot(tmp_path / "cube", frames, gel_run.force_N, "image", episodes=1)
    with pytest.raises(SensorError):
        list(read_taf_lerobot(root))
    parts = list(read_taf_lerobot(root, TafConfig(options=ReadOptions(unreadable_frame="cut"))))
    assert [(p.first_frame, len(p.frames)) for p in parts] == [(0, 3), (4, 2)]
    assert np.array_equal(parts[1].force_N, gel_run.force_N[4:])


# -- what can be wrong ----------------------------------------------------------------------------------


def the_file(root: Path, pattern: str) -> Path:
    return next(path for path in sorted(root.rglob(pattern)))


def halve(root: Path, pattern: str) -> None:
    path = the_file(root, pattern)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def spoil_force(root: Path) -> None:
    path = the_file(root / "data", "*.parquet")
    table = pq.read_table(path)
    column = table[WRENCH].to_pylist()
    column[2] = [float("nan")] * 6
    place = table.column_names.index(WRENCH)
    pq.write_table(table.set_column(place, WRENCH, pa.array(column, pa.list_(pa.float32()))), path)


def link_video_outside(root: Path) -> None:
    path = the_file(root, "*.mp4")
    path.rename(root.parents[1] / "elsewhere.mp4")
    path.symlink_to(root.parents[1] / "elsewhere.mp4")


def dots_in_video_path(info: dict[str, Any]) -> None:
    info["video_path"] = "../../" + info["video_path"]


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda root: halve(root, "*.mp4"), r"\.mp4"),
        (lambda root: halve(root / "data", "*.parquet"), "whole parquet"),
        (lambda root: halve(root, "info.json"), "JSON"),
        (lambda root: (root / "meta" / "info.json").write_text("[1]"), "JSON object"),
        (lambda root: edit_info(root, lambda info: info.pop("features")), "features in .*None"),
        (lambda root: edit_info(root, lambda info: info.update(codebase_version="v2.1")), r"v3, got v2\.1"),
        (lambda root: edit_info(root, lambda info: info.update(total_frames=20)), "20 frames"),
        (lambda root: edit_info(root, dots_in_video_path), "a path inside"),
        (spoil_force, "NaN or inf in row 2"),
        (link_video_outside, "a path inside"),
    ],
)
def test_broken_datasets_are_refused(lerobot: Path, damage: Callable[[Path], Any], says: str) -> None:
    damage(lerobot)
    with pytest.raises(DatasetError, match=says):
        list(read_taf_lerobot(lerobot))


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"meta/info\.json"):
        list(read_taf_lerobot(tmp_path))


def test_a_picture_outside_the_file_is_refused(tmp_path: Path, gel_run: Any) -> None:
    root = write_lerobot(tmp_path / "cube", gel_run.raw, gel_run.force_N, "image", episodes=1)
    path = the_file(root / "data", "*.parquet")
    table = pq.read_table(path)
    cells = pa.array([{"bytes": None, "path": "/etc/hostname"}] * len(table))
    pq.write_table(table.set_column(table.column_names.index(GEL), GEL, cells), path)
    with pytest.raises(DatasetError, match="pictures inside the file"):
        list(read_taf_lerobot(root))
