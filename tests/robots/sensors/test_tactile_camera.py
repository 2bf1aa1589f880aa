"""The tactile camera against the MJPEG stand-in: markers, reference, every fault ten times."""

import re

import cv2
import draccus
import numpy as np
import pytest
from lerobot.cameras.configs import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs

from uniforce_robots.sensors import (
    UniforceTactileCamera,
    UniforceTactileCameraConfig,
    faults,
)
from uniforce_vtla.contracts import check_marker_image
from uniforce_vtla.errors import ContractError, SensorError

TIMES = 10
MAX_AGE_MS = 150.0


def config(address, **options):
    plain = {"sensor": "tactip", "finger": "right", "frozen_after": 4, "reference_samples": 3}
    plain |= {"capture_width": 640, "capture_height": 480}
    plain |= {"connect_ms": 60_000.0, "reference_on_connect": False}
    return UniforceTactileCameraConfig(source=address, **(plain | options))


@pytest.fixture
def camera(mjpeg):
    with UniforceTactileCamera(config(mjpeg.address)) as camera:
        yield camera


def test_a_robot_lists_it_like_any_camera(mjpeg):
    cameras = make_cameras_from_configs({"tactile_right": config(mjpeg.address)})
    camera = cameras["tactile_right"]
    assert isinstance(camera, UniforceTactileCamera) and (camera.height, camera.width) == (480, 640)
    with camera:
        image = camera.read_latest(60_000)
        assert image.shape == (480, 640, 3) and image.dtype == np.uint8
        assert np.array_equal(image[..., 0], image[..., 2])
        count = cv2.connectedComponents(check_marker_image(image[..., 0]))[0] - 1
        assert 110 <= count <= 135  # a TacTip has 127 pins
    assert not camera.is_connected


SCENE = {"type": "uniforce_scene", "source": "http://x", "width": 224, "height": 224}
TACTILE = {"type": "uniforce_tactile", "sensor": "tactip", "finger": "right", "source": "0"}
TACTILE["gain"] = None


@pytest.mark.parametrize("written", [SCENE, TACTILE])
def test_a_config_file_makes_it_and_is_made_of_it(written):
    read = draccus.decode(CameraConfig, written)
    assert all(getattr(read, name) == value for name, value in written.items())
    assert draccus.decode(CameraConfig, draccus.encode(read, CameraConfig)) == read


def test_reads_deliver_new_frames_and_latest_is_a_peek(camera):
    first = camera.latest(60_000)
    assert camera.next_touch(first.index, 60_000).index > first.index
    assert camera.async_read(60_000).shape == camera.read_latest(60_000).shape == (480, 640, 3)
    assert camera.latest(60_000).raw.shape == (480, 640, 3) and first.age_ms >= 0


DEAD = {"stall": faults.StaleSensorError, "freeze": faults.FrozenSensorError}
DEAD |= {"size": faults.WrongSensorError, "stop": faults.LostSensorError}


@pytest.mark.parametrize("fault, kind", DEAD.items())
def test_a_dead_camera_is_a_typed_error_and_comes_back(
    mjpeg, camera, fails_and_recovers, fault, kind
):
    fails_and_recovers(mjpeg, fault, kind, camera.latest, camera.next_touch, MAX_AGE_MS)


def test_garbage_costs_no_good_frame(mjpeg, camera):
    for _ in range(TIMES):
        mjpeg.inject("garbage")
        after = camera.next_touch(camera.latest(1e4).index + 1, 60_000)
        assert after.raw.shape == (480, 640, 3)
        mjpeg.inject("none")
    assert camera.counts.bad > 0


def test_a_reference_in_free_air(mjpeg, camera):
    with pytest.raises(ContractError, match="take_reference"):
        camera.reference_image()
    for _ in range(60):  # the stand-in presses a third of the time
        try:
            reference = camera.take_reference()
            break
        except SensorError as error:
            assert "in contact" in str(error)
    assert np.array_equal(camera.reference_image()[..., 0], reference)


def test_a_lost_camera_cannot_be_connected(mjpeg):
    mjpeg.inject("stop")
    with pytest.raises(faults.LostSensorError, match="MJPEG server"):
        UniforceTactileCamera(config(mjpeg.address)).connect()


BEYOND = {
    "max_age_ms": (0, -1.0, 1e9, float("nan"), float("inf")),
    "frozen_after": (0, 1, 31, 10**9),
}
BEYOND |= {"fps": (0, 10**6), "reference_samples": (0, 1, 10**6), "connect_ms": (1e12,)}


@pytest.mark.parametrize(
    "options, says",
    [
        ({"sensor": "uskin"}, "uniforce_uskin"),
        ({"finger": "thumb"}, "left or right"),
        ({"fps": 5, "frozen_after": 8}, "frozen_after"),
        *(({name: value}, name) for name, values in BEYOND.items() for value in values),
    ],
)
def test_configs_that_cannot_be(options, says):
    with pytest.raises(ContractError, match=re.escape(says)):
        config("http://127.0.0.1:1/", **options)


def test_opencv_reads_the_stand_in_too(mjpeg):
    """An independent client, so that stand-in and driver can't be wrong together."""
    capture = cv2.VideoCapture(mjpeg.address, cv2.CAP_FFMPEG)
    ok, frame = capture.read()
    capture.release()
    assert ok and frame.shape == (480, 640, 3)
