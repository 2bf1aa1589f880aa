"""Stock ``lerobot-record`` with our camera: exact tactile video, or no episode at all."""

import sys
from dataclasses import dataclass, field
from typing import Any

import av
import numpy as np
import pytest
import recording_fakes  # noqa: F401  registers the teleoperator recording_test
from lerobot.cameras import CameraConfig, make_cameras_from_configs
from lerobot.robots import Robot, RobotConfig
from lerobot.scripts import lerobot_record

import uniforce_robots.sensors  # noqa: F401  (registers the cameras)
from uniforce_robots.sensors.lossy_recording import LOSSLESS
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.keys import AXES

HERE = "still_devices"  # LeRobot imports a device from its config's module


@RobotConfig.register_subclass("still_robot")
@dataclass(kw_only=True)
class StillRobotConfig(RobotConfig):
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


class StillRobot(Robot):
    config_class = StillRobotConfig
    name = "still_robot"
    action_features: dict[str, Any] = dict.fromkeys(AXES, float)
    is_calibrated = True
    is_connected = False

    def __init__(self, config):
        super().__init__(config)
        self.cameras = make_cameras_from_configs(config.cameras)

    def calibrate(self): ...

    configure = calibrate

    def connect(self, calibrate=True):
        for camera in self.cameras.values():
            camera.connect()
        self.is_connected = True

    def disconnect(self):
        for camera in self.cameras.values():
            camera.disconnect()
        self.is_connected = False

    @property
    def observation_features(self):
        return self.action_features | {
            name: (c.height, c.width, 3) for name, c in self.cameras.items()
        }

    def get_observation(self):
        return dict.fromkeys(AXES, 0.0) | {
            name: c.read_latest(60_000) for name, c in self.cameras.items()
        }

    def send_action(self, action):
        return action


@pytest.fixture
def record(mjpeg, tmp_path, monkeypatch):
    """Run ``lerobot-record`` for half a second with more flags; return the dataset's folder."""
    monkeypatch.setitem(sys.modules, HERE, sys.modules[__name__])
    monkeypatch.setattr(StillRobotConfig, "__module__", HERE)

    def run(*flags, delivers="markers"):
        camera = (
            f"{{type: uniforce_tactile, sensor: tactip, finger: right, source: '{mjpeg.address}', "
            f"delivers: {delivers}, capture_width: 640, capture_height: 480, connect_ms: 60000, "
            "reference_on_connect: false}"
        )
        devices = ["--robot.type=still_robot", f"--robot.cameras={{tactile_right: {camera}}}"]
        paths = [
            "--robot.id=a",
            f"--robot.calibration_dir={tmp_path}",
            "--teleop.type=recording_test",
        ]
        paths += [f"--teleop.calibration_dir={tmp_path}", f"--dataset.root={tmp_path / 'data'}"]
        data = [
            "--dataset.repo_id=local/touch",
            "--dataset.single_task=wipe",
            "--dataset.push_to_hub=false",
        ]
        short = ["--dataset.num_episodes=1", "--dataset.episode_time_s=0.5", "--dataset.fps=10"]
        argv = ["lerobot-record", *devices, *paths, *data, *short, "--play_sounds=false", *flags]
        monkeypatch.setattr(sys, "argv", argv)
        lerobot_record.main()
        return tmp_path / "data"

    return run


@pytest.mark.parametrize(
    "flags, delivers",
    [
        ([], "markers"),
        (["--dataset.rgb_encoder.vcodec=libsvtav1", "--dataset.rgb_encoder.crf=0"], "markers"),
        (["--dataset.rgb_encoder.vcodec=h264"], "markers"),
        ([*LOSSLESS.split()[:2], "--dataset.streaming_encoding=true"], "markers"),
        (LOSSLESS.split(), "raw"),
    ],
)
def test_a_recording_with_loss_is_refused_before_its_first_episode(
    record, tmp_path, flags, delivers
):
    with pytest.raises(DatasetError, match=r"uniforce record, or add .*--dataset.video=false"):
        record(*flags, delivers=delivers)
    assert {path.name for path in (tmp_path / "data").rglob("*.*")} == {"info.json"}


def test_the_flags_it_names_store_tactile_video_exactly(record):
    root = record(*LOSSLESS.split())
    video = next(root.rglob("*.mp4"))
    with av.open(str(video)) as stored:
        frames = [frame.to_ndarray(format="rgb24") for frame in stored.decode(video=0)]
    assert len(frames) >= 3 and all(
        np.isin(frame, (0, 255)).all() and frame.any() for frame in frames
    )


def test_images_beside_the_rows_are_exact_too(record):
    root = record("--dataset.video=false")
    info = (root / "meta/info.json").read_text()
    assert not list(root.rglob("*.mp4")) and '"dtype": "image"' in info
