"""Camera settings and failures, with a scripted capture; the scene camera."""

import cv2
import numpy as np
import pytest
from scripted import ScriptedCapture

from uniforce_robots.sensors import (
    UniforceSceneCamera,
    UniforceSceneCameraConfig,
    UniforceTactileCameraConfig,
    camera_source,
)
from uniforce_robots.sensors.camera_source import FAILED_READS, CameraSource, open_capture
from uniforce_robots.sensors.faults import LostSensorError, WrongSensorError
from uniforce_robots.sensors.finger import middle
from uniforce_robots.sensors.mjpeg import StreamSource
from uniforce_robots.sensors.reader import now_ns

SIZE = {"capture_width": 64, "capture_height": 48}


@pytest.fixture
def capture():
    return ScriptedCapture()


@pytest.fixture
def make(capture):
    def build(**options):
        config = UniforceTactileCameraConfig(**(SIZE | {"source": "/dev/video9"} | options))
        return CameraSource(config, lambda source: capture)

    return build


def test_settings_are_asked_in_the_order_drivers_accept(capture, make):
    source = make()
    source.open()
    order = [prop for prop, _ in capture.asked]
    assert order[0] == cv2.CAP_PROP_FOURCC  # decides which sizes exist
    assert order.index(cv2.CAP_PROP_AUTO_EXPOSURE) < order.index(cv2.CAP_PROP_EXPOSURE)
    assert order.index(cv2.CAP_PROP_AUTO_WB) < order.index(cv2.CAP_PROP_WB_TEMPERATURE)
    assert capture.values[cv2.CAP_PROP_BUFFERSIZE] == 1
    assert capture.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1  # manual
    is_now = source.settings_read_back
    assert (is_now["width"], is_now["exposure_100us"]) == (64, 100)
    assert len(is_now) == len(order) == 10


REFUSED = {
    cv2.CAP_PROP_FOURCC: "fourcc",
    cv2.CAP_PROP_FRAME_WIDTH: "width",
    cv2.CAP_PROP_FPS: "fps",
}
REFUSED[cv2.CAP_PROP_AUTO_EXPOSURE] = "auto_exposure"
REFUSED[cv2.CAP_PROP_WB_TEMPERATURE] = "white_balance_K"


@pytest.mark.parametrize("prop, name", REFUSED.items())
def test_a_refused_setting_is_an_error_that_names_it(capture, make, prop, name):
    capture.refuses = {prop}
    with pytest.raises(WrongSensorError, match=name):
        make().open()
    assert capture.released == 1


def test_null_leaves_a_control_alone(capture, make):
    make(fourcc=None, exposure_100us=None, white_balance_K=None, gain=None).open()
    exposure = {cv2.CAP_PROP_EXPOSURE, cv2.CAP_PROP_AUTO_EXPOSURE}
    assert not capture.values.keys() & (exposure | {cv2.CAP_PROP_AUTO_WB, cv2.CAP_PROP_GAIN})


def test_frames_are_rgb_and_stamped_on_arrival(make):
    source = make()
    before = now_ns()
    source.open()
    ((stamp_ns, frame),) = source.read()
    assert frame[0, 9].tolist() == [0, 0, 1] and before < stamp_ns <= now_ns()
    assert source.counts.samples == 1


def test_a_camera_that_does_not_open(capture, make):
    capture.opens = False
    with pytest.raises(LostSensorError, match="doesn't open"):
        make().open()


def test_failed_reads_in_a_row_mean_it_is_gone(capture, make):
    source = make()
    source.open()
    capture.works = False
    assert all(source.read() == [] for _ in range(FAILED_READS - 1))
    with pytest.raises(LostSensorError, match="unplugged"):
        source.read()
    assert source.counts.bad == FAILED_READS


def test_a_frame_of_another_size(capture, make):
    source = make()
    source.open()
    capture.frame = np.zeros((240, 320, 3), np.uint8)
    with pytest.raises(WrongSensorError, match="320×240"):
        source.read()


@pytest.mark.parametrize("source", ["1", "/dev/video1", "linked"])
def test_a_metadata_node_is_named_as_such(capture, make, tmp_path, monkeypatch, source):
    for number, (index, usb) in enumerate(((0, "c270"), (1, "c270"), (0, "c920"))):
        node = tmp_path / f"video{number}"
        node.mkdir()
        (node / "index").write_text(f"{index}\n")
        (node / "device").symlink_to(tmp_path / usb)
    monkeypatch.setattr(camera_source, "SYS_VIDEO", tmp_path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "linked").symlink_to("/dev/video1")
    capture.opens = False
    with pytest.raises(LostSensorError, match=r"metadata node.*source=/dev/video0"):
        make(source=source).open()
    assert camera_source.first_node("0") == camera_source.first_node("7") == ""


def test_an_absent_device_is_named():
    with pytest.raises(LostSensorError, match="/dev/video987"):
        open_capture("987")


@pytest.mark.parametrize("address", ["http://", "https://127.0.0.1/x", "http://127.0.0.1:port/"])
def test_addresses_that_cannot_be(address):
    with pytest.raises(LostSensorError, match="http://host:port"):
        StreamSource(UniforceTactileCameraConfig(source=address)).open()


def test_the_middle_is_cut_out_and_made_smaller(capture):
    config = UniforceSceneCameraConfig(source="0", width=24, height=24, max_age_ms=1000.0, **SIZE)
    with UniforceSceneCamera(config, lambda source: capture) as device:
        image = device.read_latest()
        assert image.shape == (24, 24, 3) == device.latest().raw.shape
        assert image.max() < 255, "the left edge isn't in the middle"


@pytest.mark.parametrize("aspect, shape", [(1.0, (48, 48)), (2.0, (32, 64)), (4 / 3, (48, 64))])
def test_the_middle_is_the_largest_one(aspect, shape):
    assert middle(np.zeros((48, 64, 3), np.uint8), aspect).shape[:2] == shape
