import numpy as np
import pytest
import torch

from uniforce_vtla import Canonicalizer, ForceHead, Tokenizer, to_finger_frame
from uniforce_vtla.contracts import ContactState, MarkerPair, check_marker_image
from uniforce_vtla.errors import ContractError, UniForceError, expected, without_credentials
from uniforce_vtla.markers.taxel_render import TaxelScales
from uniforce_vtla.tokenizer import pool_latent
from uniforce_vtla.tokenizer.force_head import ForceRegressor, HeadConfig

BLANK = np.zeros((480, 640), np.uint8)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((480, 640, 3), np.uint8),
        np.zeros((480, 640), np.float32),
        np.zeros((0, 640), np.uint8),
        np.full((4, 4), 7, np.uint8),
        [[0, 255]],
    ],
)
def test_what_is_no_marker_image_is_refused(image):
    with pytest.raises(ContractError, match="expected"):
        check_marker_image(image)


def test_a_pair_needs_equal_sizes_and_a_finger():
    with pytest.raises(ContractError, match="pair"):
        MarkerPair(BLANK, BLANK[:, :320], "left", "gelsight")
    with pytest.raises(ContractError, match="left or right"):
        MarkerPair(BLANK, BLANK, "thumb", "gelsight")


@pytest.mark.parametrize(
    "force, torsion, reason",
    [
        (np.zeros((1, 2)), np.zeros(1), "One row"),
        (np.array([[0, 0, np.nan]]), np.zeros(1), "finite"),
        (np.array([[0, 0, -1.0]]), np.zeros(1), "compression"),
    ],
)
def test_impossible_contacts_are_refused(force, torsion, reason):
    with pytest.raises(ContractError, match=reason):
        ContactState(np.zeros((1, 4, 4)), force, torsion)


@pytest.mark.parametrize(
    "text, without",
    [
        ("http://anna:s3cret@cam:81/video", "http://***@cam:81/video"),
        ("rtsp://anna:p@ss@cam", "rtsp://***@cam"),
        ("http://anna:s3/cr'et@cam", "http://***@cam"),
        ('"source": "http://anna:s3cret@cam"', '"source": "http://***@cam"'),
        (
            "http://cam/video?size=2&access_token=abc.def&x=1",
            "http://cam/video?size=2&access_token=***&x=1",
        ),
        ("http://cam/video?Password=a b", "http://cam/video?Password=*** b"),
        ("http://cam/stream?u=anna&p=s3cret", "http://cam/stream?u=***&p=***"),
        ("http://cam/s3cret/stream?s3cret#s3cret.", "http://cam/***/stream?***#***."),
        ("(http://cam/mjpg/1/video.mjpg?resolution=640x480), again", None),
        ('{"source": "http://cam/a\\"b"}', '{"source": "http://cam/***\\"b"}'),
        ("ws://10.0.0.2:5000 and https://huggingface.co/anna/wiping", None),
        (
            "write to anna@example.org about http://cam/video?keys=3",
            "write to anna@example.org about http://cam/video?keys=***",
        ),
        ("http://cam/video at 3@5", None),
    ],
)
def test_credentials_of_an_address_are_left_out(text, without):
    wanted = text if without is None else without
    assert without_credentials(text) == wanted
    assert expected("camera", text, text, "").count(wanted) == 2


@pytest.fixture
def tokenizer(tiny):
    return Tokenizer.random(tiny, seed=1)


NOW = np.zeros((3, 96, 128), np.uint8)
NOW[:, 16:24, 16:24] = 255
FREE = NOW[:1]
RGB = np.repeat(FREE[0][..., None], 3, axis=2)
ENCODED = {
    "(H, W, 3) as current": (FREE, RGB),
    "(H, W, 3) as reference": (RGB, RGB),
    "reference and current of two sizes": (FREE, FREE[:, :80]),
    "no current image": (FREE,),
    "two references for three images": (NOW[:2], NOW),
    "a word for a reference": ("reference", NOW),
    "no images": (FREE, NOW[:0]),
    "uint8 of 0 and 1": (FREE // 255, NOW // 255),
    "booleans": (FREE > 0, NOW > 0),
    "objects": (FREE, NOW.astype(object)),
    "a reference without a dark pixel": (np.full_like(FREE, 255), NOW),
    "a pair and a current": (MarkerPair(FREE[0], FREE[0], "left", "tactip"), NOW),
    "one pixel": (FREE[:, 16:17, 16:17], FREE[:, 16:17, 16:17]),
}
LATENTS = {
    "decode: two references": lambda t, z: t.decode(NOW[:2], z),
    "decode: too few patches": lambda t, z: t.decode(FREE, z[:, :5]),
    "decode: a black reference": lambda t, z: t.decode(0 * FREE, z),
    "pool: no cells": lambda t, z: pool_latent(z, 0),
    "pool: more cells than patches": lambda t, z: pool_latent(z, 99),
    "pool: half a cell": lambda t, z: pool_latent(z, 2.5),
    "head: no latents": lambda t, z: head(t)(z[:0]),
    "head: float64": lambda t, z: head(t)(z.to(torch.float64)),
}
SCAN = np.random.default_rng(0).integers(15_000, 38_000, (16, 3))
NUMBERS = {
    "a seed of 1.5": lambda: Tokenizer.random(seed=1.5),
    "a seed of 2⁷⁰": lambda: Tokenizer.random(seed=2**70),
    "counts of 10¹⁸": lambda: Canonicalizer("uskin").pair(SCAN, SCAN + 10**18, "left"),
    "a reference of −10¹⁸": lambda: Canonicalizer("uskin").set_reference(SCAN - 10**18),
    "uint64 beyond int64": lambda: uskin().marker_image(np.full((16, 3), 2**64 - 5, np.uint64)),
    "durations": lambda: uskin().marker_image(SCAN.astype("m8[s]")),
    "an all-zero reference": lambda: Canonicalizer("uskin").set_reference(0 * SCAN),
    "a sensor that is a list": lambda: Canonicalizer(["uskin"]),
    "a scale of nothing": lambda: TaxelScales(counts_per_pitch=0),
    "a scale that is NaN": lambda: TaxelScales(area_per_count_pt2=float("nan")),
}
FORCES = {
    "NaN": np.full(3, np.nan),
    "booleans": np.array([True, False, True]),
    "objects": np.array([1, 2, None], object),
    "words": np.array(["a", "b", "c"]),
    "torch's bytes": torch.ones(3, dtype=torch.uint8),
    "a list": [1.0, 2.0, 3.0],
}


def head(tokenizer):
    return ForceHead(ForceRegressor(HeadConfig(hidden=2, mlp=2)), "tactip", tokenizer.hash)


def uskin():
    canonicalizer = Canonicalizer("uskin")
    canonicalizer.set_reference(SCAN)
    return canonicalizer


@pytest.mark.parametrize("name", ENCODED)
def test_images_that_cannot_be(name, tokenizer):
    with pytest.raises(UniForceError, match="expected"):
        tokenizer.encode(*ENCODED[name])


@pytest.mark.parametrize("name", LATENTS)
def test_latents_that_cannot_be(name, tokenizer):
    z = tokenizer.encode(FREE, NOW)
    with pytest.raises(UniForceError, match="expected"):
        LATENTS[name](tokenizer, z)


@pytest.mark.parametrize("name", NUMBERS)
def test_counts_and_seeds_that_cannot_be(name):
    with pytest.raises(UniForceError, match="expected"):
        NUMBERS[name]()


@pytest.mark.parametrize("name", FORCES)
def test_forces_that_cannot_be(name):
    with pytest.raises(UniForceError, match="expected"):
        to_finger_frame(FORCES[name], "left")
