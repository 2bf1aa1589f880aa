"""The uSkin as a LeRobot camera: marker image, reference, orientation; the chain to a latent."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lerobot.cameras.utils import make_cameras_from_configs
from properties import examples
from scripted import ScriptedSource

from uniforce_robots.fr3 import rotation_z
from uniforce_robots.sensors import UniforceUskin, UniforceUskinConfig
from uniforce_robots.sensors.config_uniforce import Orientation
from uniforce_robots.standins.scene import Scene, taxel_cycle
from uniforce_vtla.errors import ContractError, SensorError
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.tokenizer.api import Tokenizer

FREE = taxel_cycle(Scene(press_s=0), 50)[0]


def config(**options):
    plain = {"source": "x", "reference_samples": 5, "connect_ms": 30_000.0, "max_age_ms": 1000.0}
    return UniforceUskinConfig(**(plain | options))


def test_a_robot_lists_it_like_any_camera(slcan):
    cfg = config(source=slcan.address, reference_on_connect=False)
    camera = make_cameras_from_configs({"tactile_left": cfg})["tactile_left"]
    assert isinstance(camera, UniforceUskin) and (camera.height, camera.width) == (480, 640)
    with camera:
        with pytest.raises(ContractError, match="reference"):
            camera.read_latest()
        assert camera.latest().raw.shape == (16, 3)


def test_device_to_latent():
    """The chain gives the same as canonicalizer and tokenizer on the same counts."""
    tokenizer = Tokenizer.random()
    trial = ScriptedSource(taxel_cycle(Scene(), 50))  # a second of free air, then a press
    with UniforceUskin(config(), trial) as camera:
        reference = camera.reference_image()[..., 0]
        touch = camera.next_touch(60, 30_000)
        image = camera.marker_image(touch.raw)
        expected = Canonicalizer("uskin").pair(camera.reference_raw, touch.raw, "left")
    assert np.array_equal(reference, expected.reference) and np.array_equal(image, expected.current)
    z = tokenizer.encode(reference[None], image[None])
    assert z.shape == (1, tokenizer.num_patches, tokenizer.config.latent) and bool(
        z.isfinite().all()
    )


def test_a_reference_is_refused_in_contact():
    rising = np.linspace(0, 3000, 200)[:, None, None] * np.array([0, 0, 1]) + FREE
    camera = UniforceUskin(config(), ScriptedSource(rising.astype(np.uint16)))
    with pytest.raises(SensorError, match="in contact"):
        camera.connect()
    assert not camera.is_connected


def test_a_steady_touch_is_refused_against_a_resting_level(tmp_path):
    pressed = FREE + np.array([0, 0, 900]) + np.arange(50)[:, None, None] % 3
    np.save(tmp_path / "rest.npy", FREE)
    for name, kind, says in (
        ("rest", SensorError, "resting level"),
        ("absent", ContractError, r"\.npy"),
    ):
        resting = config(resting_level=str(tmp_path / f"{name}.npy"))
        with pytest.raises(kind, match=says):
            UniforceUskin(resting, ScriptedSource(pressed.astype(np.uint16))).connect()


def test_a_window_comes_upright():
    scans = taxel_cycle(Scene(press_s=0), 50)
    with UniforceUskin(config(rotation_deg=90, flip=True), ScriptedSource(scans)) as camera:
        upright = {Orientation(90, True).of_counts(scan).tobytes() for scan in scans}
        assert all(scan.tobytes() in upright for scan in camera.window(4)[1])


@pytest.mark.parametrize("wrong", [{"link": "usb"}, {"source": ""}, {"rotation_deg": 45}])
def test_configs_that_cannot_be(wrong):
    with pytest.raises(ContractError, match=next(iter(wrong))):
        config(**wrong)


COUNTS = st.integers(0, 2**32 - 1).map(
    lambda seed: np.random.default_rng(seed).integers(0, 65_536, (16, 3)).astype(np.uint16)
)


@examples(30)
@given(COUNTS, st.sampled_from([90, 180, 270]), st.booleans())
def test_turning_counts_turns_the_picture(counts, turn, flip):
    """Disc positions, in pitches about the middle, must turn as a square picture does."""
    small = counts // 64  # no clipping, or turned and unturned differ
    where = Orientation(turn, flip)
    zero = where.of_counts(np.zeros_like(small)).astype(int)
    moved = _centred(where.of_counts(small).astype(int) - zero)
    before = _centred(small.astype(int)) * ((-1, 1) if flip else (1, 1))
    turned = before @ rotation_z(np.radians(turn))[:2, :2].T
    distance = np.linalg.norm(turned[:, None] - moved[None], axis=-1)
    assert distance.min(axis=1).max() < 1e-6 and distance.min(axis=0).max() < 1e-6


def _centred(delta):
    """Return (16, 2) disc positions, x right and y up, in pitches about the patch's middle."""
    row, column = np.divmod(np.arange(16), 4)
    return np.stack([column, row], axis=1) - 1.5 + delta[:, :2] / 2000.0


def test_camera_frames_turn_too():
    frame = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    assert np.array_equal(Orientation(90).of_frame(frame), np.rot90(frame))
    assert Orientation().of_frame(frame).shape == (2, 3, 3)
