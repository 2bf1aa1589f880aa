"""The scene camera: size, middle, and the errors it shares with the fingers."""

from collections.abc import Callable

import draccus
import numpy as np
import pytest
from lerobot.cameras.configs import CameraConfig
from scripted import ScriptedCapture

from uniforce_robots.sensors import UniforceSceneCamera, UniforceSceneCameraConfig
from uniforce_robots.sensors.faults import FrozenSensorError, LostSensorError
from uniforce_robots.sensors.finger import middle
from uniforce_vtla.errors import ContractError, SensorError


def camera(capture: ScriptedCapture, **options: object) -> UniforceSceneCamera:
    plain = {"source": "0", "width": 64, "height": 48, "max_age_ms": 30_000.0}
    return UniforceSceneCamera(UniforceSceneCameraConfig(**(plain | options)), lambda source: capture)  # type: ignore[arg-type]


def test_the_middle_is_cut_out_and_made_smaller() -> None:
    with camera(ScriptedCapture(), width=24, height=24, capture_width=64, capture_height=48) as device:
        image = device.read_latest()
        assert image.shape == (24, 24, 3) == device.latest().raw.shape
        assert image.max() < 255, "the left edge isn't in the middle"


@pytest.mark.parametrize(("aspect", "shape"), [(1.0, (48, 48)), (2.0, (32, 64)), (4 / 3, (48, 64))])
def test_the_middle_is_the_largest_one(aspect: float, shape: tuple[int, int]) -> None:
    assert middle(np.zeros((48, 64, 3), np.uint8), aspect).shape[:2] == shape


@pytest.mark.parametrize(("what", "kind"), [("changes", FrozenSensorError), ("works", LostSensorError)])
def test_a_camera_that_is_not_well(what: str, kind: type[SensorError], outcome: Callable) -> None:
    capture = ScriptedCapture()
    with camera(capture) as device:
        setattr(capture, what, False)
        outcome(lambda: device.read_latest(), kind)


def test_its_config_goes_through_a_file_and_needs_a_source() -> None:
    written = {"type": "uniforce_scene", "source": "http://x", "width": 224, "height": 224}
    read = draccus.decode(CameraConfig, written)
    assert isinstance(read, UniforceSceneCameraConfig)
    assert draccus.decode(CameraConfig, draccus.encode(read, CameraConfig)) == read
    with pytest.raises(ContractError, match="source"):
        UniforceSceneCameraConfig()
