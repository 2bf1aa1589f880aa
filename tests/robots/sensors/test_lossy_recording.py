"""Stock ``lerobot-record`` with our camera: exact tactile video, or no episode at all."""

import sys
from types import SimpleNamespace

import av
import numpy as np
import pytest
import recording_fakes  # noqa: F401  registers the teleoperator recording_test
from lerobot.cameras import make_cameras_from_configs
from lerobot.scripts import lerobot_record

import uniforce_robots.franka  # noqa: F401  (registers the robot and its cameras)
from uniforce_robots.sensors.lossy_recording import LOSSLESS
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.keys import AXES


def still_robot(config):
    """As far as LeRobot asks: axes that stay, and the camera."""
    camera = make_cameras_from_configs(config.cameras)["tactile_right"]
    axes = dict.fromkeys(AXES, 0.0)
    features = dict.fromkeys(AXES, float)
    return SimpleNamespace(
        name="still_robot",
        cameras=config.cameras,
        action_features=features,
        observation_features=features | {"tactile_right": (480, 640, 3)},
        is_connected=True,
        connect=camera.connect,
        disconnect=camera.disconnect,
        get_observation=lambda: axes | {"tactile_right": camera.read_latest(60_000)},
        send_action=lambda action: action,
    )


@pytest.fixture
def record(mjpeg, tmp_path, monkeypatch):
    """Run ``lerobot-record`` for half a second with more flags; return the dataset's folder."""
    monkeypatch.setattr(lerobot_record, "make_robot_from_config", still_robot)

    def run(*flags):
        camera = (
            f"{{type: uniforce_tactile, sensor: tactip, finger: right, source: '{mjpeg.address}', "
            "capture_width: 640, capture_height: 480, connect_ms: 60000, "
            "reference_on_connect: false}"
        )
        words = (
            "--robot.type=uniforce_franka --teleop.type=recording_test --robot.id=a"
            f" --robot.calibration_dir={tmp_path} --teleop.calibration_dir={tmp_path}"
            f" --dataset.root={tmp_path}/data --dataset.repo_id=local/touch"
            " --dataset.single_task=wipe --dataset.push_to_hub=false --dataset.num_episodes=1"
            " --dataset.episode_time_s=0.5 --dataset.fps=10 --play_sounds=false"
        )
        cameras = f"--robot.cameras={{tactile_right: {camera}}}"
        monkeypatch.setattr(sys, "argv", ["lerobot-record", cameras, *words.split(), *flags])
        lerobot_record.main()
        return tmp_path / "data"

    return run


@pytest.mark.parametrize(
    "flags",
    [
        [],
        ["--dataset.rgb_encoder.vcodec=libsvtav1", "--dataset.rgb_encoder.crf=0"],
        ["--dataset.rgb_encoder.vcodec=h264"],
        [*LOSSLESS.split()[:2], "--dataset.streaming_encoding=true"],
    ],
)
def test_a_recording_with_loss_is_refused_before_its_first_episode(record, tmp_path, flags):
    with pytest.raises(DatasetError, match=r"uniforce record, or add .*--dataset.video=false"):
        record(*flags)
    assert {path.name for path in (tmp_path / "data").rglob("*.*")} == {"info.json"}


def test_the_flags_it_names_store_tactile_video_exactly(record):
    root = record(*LOSSLESS.split())
    video = next(root.rglob("*.mp4"))
    with av.open(str(video)) as stored:
        frames = [frame.to_ndarray(format="rgb24") for frame in stored.decode(video=0)]
    assert len(frames) >= 3 and np.isin(frames, (0, 255)).all()
    assert all(frame.any() for frame in frames)


def test_images_beside_the_rows_are_exact_too(record):
    root = record("--dataset.video=false")
    info = (root / "meta/info.json").read_text()
    assert not list(root.rglob("*.mp4")) and '"dtype": "image"' in info
