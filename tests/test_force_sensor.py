"""``ForceSensor``: the chain of touch from a raw frame to newtons, and what it refuses."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from calibration_samples import save_calibration

from uniforce_vtla import Canonicalizer, ForceHead, ForceSensor, Tokenizer
from uniforce_vtla.contact import free_air
from uniforce_vtla.contact.worn import WornView
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import CheckpointError, ContractError, SensorError
from uniforce_vtla.tokenizer import pool_latent
from uniforce_vtla.tokenizer.latent_range import (
    FREE_LOOKS,
    FreeAirError,
    HealthMonitor,
    LatentRange,
)

KINDS = ("tactip", "uskin", "gelsight")


@pytest.fixture(scope="module")
def tokenizer():
    return Tokenizer.from_pretrained("nano")


@pytest.fixture(scope="module")
def head():
    return ForceHead.from_pretrained(path="nano")


@pytest.fixture(scope="module")
def raw():
    """Raw frames of unit 1 of each kind: in free air, and pressed with 4 N and sheared with 1 N."""
    return {kind: frames_of(kind) for kind in KINDS}


def frames_of(kind):
    simulator = WornView(wear(f"{kind}:1")(0)).simulator
    free = free_air(1)
    force_N = np.array([[0.0, 1.0, 6.0]], np.float32)
    pressed = replace(free, gap_mm=np.zeros_like(free.gap_mm), force_N=force_N)
    return simulator.raw_frames(free)[0], simulator.raw_frames(pressed)[0]


@pytest.fixture(scope="module")
def make_sensor(tokenizer, head):
    return partial(ForceSensor, tokenizer=tokenizer, head=head)


def read(sensor, frames):
    """Return what a sensor reads in the second of two frames, the first being free air."""
    sensor.tare(frames[0])
    return sensor.read(frames[1])


def test_a_frame_gives_what_the_parts_give_one_after_another(raw, make_sensor, tokenizer, head):
    for kind, (free, pressed) in raw.items():
        sensor = make_sensor(kind)
        reference = sensor.tare(free)
        reading = sensor.read(pressed)
        canonicalizer = Canonicalizer(kind, stream=True)
        canonicalizer.set_reference(free)
        canonicalizer.marker_image(free)
        current = canonicalizer.marker_image(pressed)
        latent = pool_latent(tokenizer.encode(reference[None], current[None], "left"))
        np.testing.assert_allclose(reading.latent, latent[0].numpy(), atol=1e-6)
        np.testing.assert_allclose(reading.force_N, head(latent)[0].numpy(), atol=1e-6)
        assert np.isnan(reading.health), "nothing is watched"


def test_newtons_are_of_the_fingers_own_frame(raw, make_sensor):
    mirrored = [np.ascontiguousarray(frame[:, ::-1]) for frame in raw["tactip"]]
    left_N = read(make_sensor("tactip", "left"), raw["tactip"]).force_N
    right_N = read(make_sensor("tactip", "right"), mirrored).force_N
    # facing fingers see one load mirrored
    np.testing.assert_allclose(left_N * (-1, 1, 1), right_N, atol=0.2)
    assert left_N[2] > 2


def test_several_frames_in_a_row_make_a_reference(raw, make_sensor):
    for kind, (free, pressed) in raw.items():
        one = read(make_sensor(kind), (free, pressed))
        several = read(make_sensor(kind), ([free, free, free], pressed))
        np.testing.assert_array_equal(one.latent, several.latent)
    free, pressed = raw["tactip"]
    with pytest.raises(SensorError, match="still"):
        make_sensor("tactip").tare([free, pressed, pressed])


def test_a_calibration_maps_the_latent_that_newtons_are_read_in(
    raw, make_sensor, tokenizer, head, tmp_path
):
    folder = save_calibration(tmp_path, tokenizer)
    before = read(make_sensor("tactip"), raw["tactip"])
    after = read(make_sensor("tactip", calibration=folder), raw["tactip"])
    np.testing.assert_allclose(after.latent, before.latent + 0.1, atol=1e-6)
    shifted = torch.from_numpy(before.latent + 0.1)[None]
    np.testing.assert_allclose(after.force_N, head.model.step(shifted, None)[0][0], rtol=1e-5)
    with pytest.raises(CheckpointError, match="tokenizer"):
        ForceSensor("tactip", tokenizer="small", calibration=folder)
    with pytest.raises(CheckpointError, match="one of a uskin, got one of tactip:3"):
        make_sensor("uskin", calibration=folder)


def test_a_sensor_that_is_not_healthy_stops_and_free_air_is_told_apart(raw, make_sensor):
    free, pressed = raw["tactip"]
    with pytest.raises(CheckpointError):  # of nano no ranges are shipped
        make_sensor("tactip", watch=FREE_LOOKS)
    sensor = ForceSensor("tactip", head=None, watch=FREE_LOOKS)
    sensor.tare(free)
    healthy = [sensor.read(free).health for _ in range(FREE_LOOKS)]
    assert 0 < max(healthy) < 1
    usual = LatentRange("tactip", sensor.tokenizer.hash, 96, 1e-3, 1e-3)
    sensor.monitor = HealthMonitor(usual, "left", FREE_LOOKS)
    with pytest.raises(FreeAirError):
        for _ in range(FREE_LOOKS):
            sensor.read(pressed)


def test_without_a_head_there_are_no_newtons(raw, make_sensor):
    assert np.isnan(read(make_sensor("uskin", head=None), raw["uskin"]).force_N).all()


def test_bad_frames_are_refused(raw, make_sensor):
    free, pressed = raw["tactip"]
    sensor = make_sensor("tactip")
    with pytest.raises(ContractError, match="tare"):
        sensor.read(pressed)
    with pytest.raises(SensorError):
        sensor.tare(np.zeros_like(free))
    sensor.tare(free)
    for frame in (np.zeros_like(free), free[:, :100], free.astype(np.float32), free[..., 0]):
        with pytest.raises((ContractError, SensorError)):
            sensor.read(frame)
    with pytest.raises(ContractError, match="kind"):
        make_sensor("").tare(free)


def test_unknown_sensors_and_fingers_are_refused(make_sensor):
    with pytest.raises(SensorError, match="tactip"):
        make_sensor("nose")
    with pytest.raises(ContractError, match="finger"):
        make_sensor("tactip", "thumb")


def test_two_threads_may_read_with_one_tokenizer(raw, make_sensor):
    free, pressed = raw["gelsight"]

    def forces(finger):
        sensor = make_sensor("gelsight", finger)
        sensor.tare(free)
        return np.array([sensor.read(pressed).force_N for _ in range(10)])

    with ThreadPoolExecutor(2) as pool:
        beside_each_other = list(pool.map(forces, FINGERS))
    for finger, found in zip(FINGERS, beside_each_other, strict=True):
        np.testing.assert_array_equal(found, forces(finger))
