import errno
import json
import os
import resource
import shutil
import time
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import Mock

import av
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_datasets import staging, video_encoder
from uniforce_datasets.cards import read_card
from uniforce_datasets.features import ColumnMaker, vector_column
from uniforce_datasets.lossless import check_dataset, open_dataset
from uniforce_datasets.pooled_quantiles import POOLED_KEYS, pooled_stats
from uniforce_datasets.raw_video import raw_path
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.source import read_source, stored_frames
from uniforce_datasets.synthetic import FPS, dots, synthetic_frame
from uniforce_datasets.video_encoder import PerKeyEncoder
from uniforce_vtla.errors import FULL, ContractError, DatasetError, DiskFullError, SensorError
from uniforce_vtla.keys import (
    ACTION,
    OUTCOME,
    OUTCOME_NAMES,
    SEED,
    STATE,
    SUCCESS,
    TACTILE_KEYS,
    camera_key,
    sensor_key,
    tactile_key,
    truth_wrench_key,
)
from uniforce_vtla.sensors import list_sensors

SHORT = 4  # frames
EPISODES = 3  # of the fixture ``demos``


def open_recorder(root, **options):
    return EpisodeRecorder(root, "local/test", "gelsight", "tactip", FPS, **options)


def add_frames(recorder, count=SHORT, seed=0, raw=None):
    """Add frames from memory that is filled over and over, as a camera's driver does; return what
    was passed."""
    rng = np.random.default_rng(seed)
    frames = [synthetic_frame(step, rng) for step in range(count)]
    memory = {key: np.empty_like(value) for key, value in frames[0].items()}
    for frame in frames:
        for key, value in frame.items():
            memory[key][:] = value
        recorder.add(memory, "wipe", raw)
    for array in memory.values():
        array[:] = 1
    return frames


def save_one(recorder, **given):
    add_frames(recorder, **given)
    recorder.save(success=True, outcome="success", seed=7, card={"label": "success"})


@pytest.mark.parametrize("channels", [1, 3])
def test_a_marker_image_may_come_with_equal_channels(channels):
    image = dots(0)
    given = np.dstack([image] * channels)
    np.testing.assert_array_equal(ColumnMaker()(TACTILE_KEYS[0], given), np.dstack([image] * 3))


@pytest.mark.parametrize("root", ["", " ", "/proc/nothing", "a\0b", "{file}"])
def test_a_root_that_cannot_be_written_is_refused(root, tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(DatasetError, match="a folder"):
        open_recorder(root.format(file=tmp_path / "file"))


@pytest.mark.parametrize("root", ["~/demos", "demos", "../home/demos"])
def test_a_root_leads_to_one_folder_wherever_the_program_goes(root, tmp_path, monkeypatch):
    home, elsewhere = tmp_path / "home", tmp_path / "elsewhere"
    home.mkdir()
    elsewhere.mkdir()
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(home)
    with open_recorder(root) as recorder:
        monkeypatch.chdir(elsewhere)
        save_one(recorder)
    monkeypatch.chdir(home)
    source = check_dataset(root)
    monkeypatch.chdir(elsewhere)
    assert source.columns((STATE,))[STATE].shape == (SHORT, 5)
    assert source.root.samefile(home / "demos")
    assert not [path for path in tmp_path.rglob("*") if "~" in path.name]
    assert not list(elsewhere.iterdir())


def test_round_trip_with_stock_loader(tmp_path):
    root = tmp_path / "data"
    recorded = []
    outcomes = ["success", "failed_grasp", "residual"]
    # three sessions: resume each time
    for number, outcome in enumerate(outcomes):
        with open_recorder(root) as recorder:
            assert recorder.num_episodes == number
            recorded += add_frames(recorder, seed=number)
            recorder.save(success=outcome == "success", outcome=outcome, seed=100 + number)
    dataset = open_dataset(root, return_uint8=True)
    assert dataset.num_episodes == 3 and len(dataset) == 3 * SHORT
    for index, frame in enumerate(recorded):
        sample = dataset[index]
        for key in TACTILE_KEYS:
            assert np.array_equal(sample[key], np.broadcast_to(frame[key], (3, 480, 640)))
        for key in (STATE, ACTION, truth_wrench_key("left")):
            assert np.array_equal(sample[key], frame[key])
        camera = sample[camera_key("front")].permute(1, 2, 0).numpy().astype(int)
        assert np.abs(camera - frame[camera_key("front")]).mean() < 6  # lossy, yet the same picture
        assert sample["task"] == "wipe"
    columns = read_source(root).columns((SUCCESS, OUTCOME, SEED, sensor_key("right")))
    ends = slice(None, None, SHORT)
    assert columns[SUCCESS][ends].tolist() == [1, 0, 0] and columns[SEED][-1] == 102
    assert [OUTCOME_NAMES[i] for i in columns[OUTCOME][ends]] == outcomes
    assert set(columns[sensor_key("right")]) == {list_sensors().index("tactip")}


def test_a_kill_between_any_two_steps_leaves_a_dataset_that_opens_verifies_and_goes_on(
    tmp_path, monkeypatch
):
    root = tmp_path / "data"
    saved = 0
    raw = np.zeros((48, 64, 3), np.uint8)
    states = {}  # what is in place → episodes saved by then, copy

    def before(step):
        def stepped(*given, **named):
            in_place = frozenset(
                (path, path.stat().st_mtime_ns)
                for path in root.rglob("*")
                if path.is_file() and staging.STAGING not in path.parts
            )
            if in_place not in states:
                copy = Path(shutil.copytree(root, tmp_path / f"state_{len(states)}"))
                states[in_place] = (saved, copy)
            return step(*given, **named)

        return stepped

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", before(os.replace))
        patch.setattr(shutil, "rmtree", before(shutil.rmtree))
        with open_recorder(root, raw_shapes={"left": raw.shape}) as recorder:
            for _ in range(2):
                save_one(recorder, count=2, raw={"left": raw})
                saved += 1
    assert len(states) > 25
    for kept, state in states.values():
        if (state / "meta" / "info.json").exists():
            assert len(check_dataset(state, "full").episodes) >= kept
        with open_recorder(state) as after:
            assert after.num_episodes >= kept
        assert (state / staging.HASHES).is_file() == bool(after.num_episodes)
        if after.num_episodes:
            assert len(check_dataset(state, "full").episodes) == after.num_episodes


def test_dropped_frame_fails_the_episode_only(tmp_path, monkeypatch):
    with open_recorder(tmp_path / "data", realtime=True, queue_frames=2) as recorder:
        save_one(recorder, count=2)
        real = video_encoder.auto_downsample_height_width

        def slow(image):
            time.sleep(0.4)
            return real(image)

        monkeypatch.setattr(video_encoder, "auto_downsample_height_width", slow)
        with pytest.raises(DatasetError, match="dropped"):
            add_frames(recorder, 5)
        monkeypatch.undo()
        assert recorder.num_episodes == 1 and recorder.num_frames == 0
        save_one(recorder, count=2)
    assert open_dataset(tmp_path / "data").num_episodes == 2


WRITES = (
    (os, "replace"),
    (os, "fsync"),
    (os, "mkdir"),
    (Path, "write_text"),
    (pq.ParquetWriter, "close"),
)


@contextmanager
def full_disk(monkeypatch, number, writes):
    """Let all but the first ``writes`` of a recorder's writes fail; yield the names of those that
    came."""
    came = []

    def counted(name, write):
        def counting(*given, **named):
            came.append(name)
            if len(came) > writes:
                raise OSError(number, os.strerror(number))
            return write(*given, **named)

        return counting

    with monkeypatch.context() as patch:
        for owner, name in WRITES:
            patch.setattr(owner, name, counted(name, getattr(owner, name)))
        yield came


def session(root):
    """Open, record one episode, close."""
    with open_recorder(root) as recorder:
        save_one(recorder)


@pytest.mark.parametrize(
    "turn",
    [0, pytest.param(1, marks=pytest.mark.thorough), pytest.param(2, marks=pytest.mark.thorough)],
)
def test_a_disk_that_fills_up_at_any_moment_is_one_error_and_costs_no_saved_episode(
    demos, tmp_path, monkeypatch, turn
):
    whole = Path(shutil.copytree(demos, tmp_path / "whole"))
    with full_disk(monkeypatch, FULL[turn], 10_000) as came:
        session(whole)
    assert set(came) == {name for _, name in WRITES}
    for writes in range(3 * turn, len(came), 17):
        root = Path(shutil.copytree(demos, tmp_path / str(writes)))
        with (
            full_disk(monkeypatch, FULL[turn], writes),
            pytest.raises(DiskFullError, match="Free some space"),
        ):
            session(root)
        with open_recorder(root) as after:
            assert after.num_episodes in (EPISODES, EPISODES + 1), writes
        assert len(check_dataset(root, "full").episodes) == after.num_episodes


@pytest.mark.parametrize("limit", [0, 2_000, 20_000])
def test_a_file_that_grows_too_large_is_a_full_disk_whoever_writes_it(copy, limit):
    """A limit of this process: videos and tables are written by libraries, out of a test's
    reach."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with open_recorder(copy) as recorder:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
        try:
            with pytest.raises(DiskFullError, match=f"{EPISODES} saved episodes"):
                save_one(recorder)
            with pytest.raises(DiskFullError, match="statistics"):
                recorder.close()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    session(copy)
    assert len(check_dataset(copy, "full").episodes) == EPISODES + 1


def test_what_operating_systems_leave_in_a_folder_is_none_of_a_dataset(copy, tmp_path):
    for folder in (tmp_path / "new", copy, *(p for p in copy.rglob("*") if p.is_dir())):
        folder.mkdir(exist_ok=True)
        for name in (".DS_Store", "._file-000.parquet", "Thumbs.db", "desktop.ini", ".nfs0001"):
            (folder / name).write_bytes(b"\0\5\x16\7")
    session(tmp_path / "new")
    session(copy)
    assert len(check_dataset(copy, "full").episodes) == EPISODES + 1
    with pytest.raises(DatasetError, match=r"\._file-000\.parquet.*Delete it"):
        open_dataset(copy)


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOTSUP])
def test_a_folder_that_cannot_be_synced_holds_a_dataset_nevertheless(tmp_path, monkeypatch, number):
    sync = os.fsync

    def unable(handle):
        if os.path.isdir(f"/proc/self/fd/{handle}"):
            raise OSError(number, os.strerror(number))
        sync(handle)

    monkeypatch.setattr(os, "fsync", unable)
    session(tmp_path / "data")
    assert len(check_dataset(tmp_path / "data", "full").episodes) == 1


@pytest.mark.parametrize(
    "error", [PermissionError(13, "Permission denied"), NotImplementedError("no flock")]
)
def test_a_folder_that_cannot_be_locked_is_one_line_before_the_first_episode(
    tmp_path, monkeypatch, error
):
    monkeypatch.setattr(staging.FileLock, "acquire", Mock(side_effect=error))
    with pytest.raises(DatasetError, match="can be locked"):
        open_recorder(tmp_path / "data")


def test_damaged_marker_video_is_caught_before_it_counts(tmp_path, monkeypatch):
    monkeypatch.setattr(video_encoder, "codec_of", lambda key: video_encoder.camera_codec())
    with open_recorder(tmp_path / "data") as recorder:
        with pytest.raises(DatasetError, match="tactile_left"):
            save_one(recorder)
        assert recorder.num_episodes == 0


@pytest.mark.parametrize(
    "change, error",
    [
        ({STATE: np.zeros(4, np.float32)}, "observation.state"),
        ({STATE: np.full(5, np.nan, np.float32)}, "finite"),
        ({ACTION: np.zeros(5, np.float64)}, "action"),
        ({"observation.extra": np.zeros(1, np.float32)}, "unknown"),
        ({tactile_key("left"): np.full((480, 640), 7, np.uint8)}, "only 0 and 255"),
        ({tactile_key("left"): dots(0)[:100]}, "tactile_left"),
        ({camera_key("front"): np.zeros((10, 10, 3), np.uint8)}, "front"),
    ],
)
def test_bad_frames_are_refused(tmp_path, change, error):
    with open_recorder(tmp_path / "data") as recorder:
        frame = synthetic_frame(0, np.random.default_rng(0)) | change
        with pytest.raises(ContractError, match=error):
            recorder.add(frame, "wipe")
        assert recorder.num_frames == 0


def test_missing_column_unknown_outcome_cause_and_sensor(tmp_path):
    with open_recorder(tmp_path / "data") as recorder:
        frame = synthetic_frame(0, np.random.default_rng(0))
        del frame[tactile_key("right", reference=True)]
        with pytest.raises(ContractError, match=r"missing.*tactile_right_ref"):
            recorder.add(frame, "wipe")
        with pytest.raises(ContractError, match="outcome"):
            recorder.save(True, "great", 0)
        with pytest.raises(ContractError, match="cause"):
            recorder.save(False, "aborted", 0, cause="moon")
        with pytest.raises(DatasetError, match="2 frames"):
            recorder.save(True, "success", 0)
    with pytest.raises(SensorError, match="sensor"):
        EpisodeRecorder(tmp_path / "other", "local/x", "digit", "tactip")


def test_wrong_places_are_refused(tmp_path, demos):
    with open_recorder(tmp_path / "data"), pytest.raises(DatasetError, match="one recorder"):
        open_recorder(tmp_path / "data")
    with pytest.raises(DatasetError, match="features"):
        open_recorder(demos, truth=True, cameras=(64, 64, 3))
    with pytest.raises(DatasetError, match=r"measured\.q"):
        open_recorder(demos, further={"measured.q": vector_column(["q1"])})
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    with pytest.raises(DatasetError, match="empty folder"):
        open_recorder(tmp_path / "full")


def test_raw_frames_and_a_card_are_moved_in_with_the_episode(tmp_path):
    root = tmp_path / "data"
    raw = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    with open_recorder(root, raw_shapes={"right": raw.shape}) as recorder:
        for number in range(3):
            add_frames(recorder, raw={"right": raw})
            if number == 1:
                recorder.discard()
                assert recorder.num_frames == 0
            else:
                recorder.save(True, "success", 0, card={"label": "success", "n": number})
        with pytest.raises(ContractError, match="raw tactile frames"):
            add_frames(recorder)
    assert [read_card(root, episode)["n"] for episode in (0, 1)] == [0, 2]
    assert [stored_frames(raw_path(root, "right", episode)) for episode in (0, 1)] == [SHORT] * 2
    assert open_dataset(root).num_episodes == 2 and not raw_path(root, "right", 2).exists()
    assert not (root / staging.STAGING).exists()
    with pytest.raises(DatasetError, match="card"):
        read_card(root, 2)


def test_recorded_statistics_are_pooled(demos):
    stats = json.loads((demos / "meta" / "stats.json").read_text())
    for key, values in read_source(demos).columns(POOLED_KEYS).items():
        assert values.shape == (60, 5) and stats[key]["count"] == [60]
        values = values.astype(np.float64)
        for quantile in (1, 10, 50, 90, 99):
            wanted = np.quantile(values, quantile / 100, axis=0)
            np.testing.assert_allclose(stats[key][f"q{quantile:02d}"], wanted, rtol=1e-12)
        for name in ("mean", "std", "min"):
            np.testing.assert_allclose(stats[key][name], getattr(values, name)(axis=0))


def test_a_reference_that_changes_within_a_video_comes_back_exactly(tmp_path):
    """It is converted once; a new one in the middle must still be seen."""
    key = tactile_key("left", reference=True)
    sent = [np.repeat(dots(shift)[..., None], 3, axis=2) for shift in (0, 0, 0, 1, 2, 2, 2, 3, 3)]
    encoder = PerKeyEncoder(FPS, queue_frames=len(sent), realtime=True)
    encoder.start_episode([key], tmp_path)
    for frame in sent:
        encoder.feed_frame(key, frame)
    path, _ = encoder.finish_episode()[key]
    with av.open(str(path)) as container:
        shown = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert np.array_equal(shown, sent)


@examples(20)
@given(st.integers(1, 50), st.integers(0, 2**16))
def test_statistics_do_not_depend_on_the_order_of_episodes(frames, seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(frames, 3))
    first, shuffled = pooled_stats(values), pooled_stats(rng.permutation(values))
    for name, value in first.items():
        np.testing.assert_allclose(value, shuffled[name], atol=1e-12)
