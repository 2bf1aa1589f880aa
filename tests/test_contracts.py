import numpy as np
import pytest
import torch

from uniforce_vtla import Canonicalizer, ForceHead, Tokenizer, to_finger_frame
from uniforce_vtla.contracts import ContactState, MarkerPair, check_finger, check_marker_image
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
    assert check_finger("left") == "left"


@pytest.mark.parametrize(
    "force, torsion, reason",
    [
        (np.zeros((1, 2)), np.zeros(1), "one row|One row"),
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


SCAN = np.random.default_rng(0).integers(15_000, 38_000, (16, 3))


@pytest.fixture
def tokenizer(tiny):
    return Tokenizer.random(tiny, seed=1)


def rgb(dots):
    return np.repeat(dots[1][..., None], 3, axis=2)


IMAGES = {
    "(H, W, 3) as current": lambda t, dots: t.encode(dots[:1], rgb(dots)),
    "(H, W, 3) as reference": lambda t, dots: t.encode(rgb(dots), rgb(dots)),
    "reference and current of two sizes": lambda t, dots: t.encode(dots[:1], dots[:1, :80]),
    "no current image": lambda t, dots: t.encode(dots[:1]),
    "two references for three images": lambda t, dots: t.encode(dots[:2], dots),
    "no finger": lambda t, dots: t.encode(dots[:1], dots, finger="middle"),
    "a word for a reference": lambda t, dots: t.encode("reference", dots),
    "no images": lambda t, dots: t.encode(dots[:1], dots[:0]),
    "uint8 of 0 and 1": lambda t, dots: t.encode(dots[:1] // 255, dots // 255),
    "booleans": lambda t, dots: t.encode(dots[:1] > 0, dots > 0),
    "objects": lambda t, dots: t.encode(dots[:1], dots.astype(object)),
    "NaN": lambda t, dots: t.encode(dots[:1], np.full((1, 96, 128), np.nan)),
    "a reference without a dark pixel": lambda t, dots: t.encode(np.full_like(dots[:1], 255), dots),
    "a pair and a current": lambda t, dots: t.encode(
        MarkerPair(dots[0], dots[1], "left", "tactip"), dots
    ),
    "one pixel": lambda t, dots: t.encode(dots[:1, 16:17, 16:17], dots[:1, 16:17, 16:17]),
    "decode: two references": lambda t, dots: t.decode(dots[:2], t.encode(dots[:1], dots)),
    "decode: too few patches": lambda t, dots: t.decode(dots[:1], t.encode(dots[:1], dots)[:, :5]),
    "decode: a black reference": lambda t, dots: t.decode(0 * dots[:1], t.encode(dots[:1], dots)),
    "pool: no cells": lambda t, dots: pool_latent(t.encode(dots[:1], dots), 0),
    "pool: more cells than patches": lambda t, dots: pool_latent(t.encode(dots[:1], dots), 99),
    "pool: half a cell": lambda t, dots: pool_latent(t.encode(dots[:1], dots), 2.5),
    "head: no latents": lambda t, dots: head(t)(t.encode(dots[:1], dots)[:0]),
    "head: float64": lambda t, dots: head(t)(t.encode(dots[:1], dots).to(torch.float64)),
    "a seed of 1.5": lambda t, dots: Tokenizer.random(t.config, seed=1.5),
    "a seed of 2⁷⁰": lambda t, dots: Tokenizer.random(t.config, seed=2**70),
}
COUNTS = {
    "counts of 10¹⁸": lambda: Canonicalizer("uskin").pair(SCAN, SCAN + 10**18, "left"),
    "a reference of −10¹⁸": lambda: Canonicalizer("uskin").set_reference(SCAN - 10**18),
    "uint64 beyond int64": lambda: uskin().marker_image(np.full((16, 3), 2**64 - 5, np.uint64)),
    "durations": lambda: uskin().marker_image(SCAN.astype("m8[s]")),
    "an all-zero reference": lambda: Canonicalizer("uskin").set_reference(0 * SCAN),
    "a pair with an all-zero reference": lambda: Canonicalizer("uskin").pair(
        0 * SCAN, SCAN, "left"
    ),
    "a sensor that is a list": lambda: Canonicalizer(["uskin"]),
    "a scale of nothing": lambda: TaxelScales(counts_per_pitch=0),
    "a scale that is NaN": lambda: TaxelScales(area_per_count_pt2=float("nan")),
    "a force that is NaN": lambda: to_finger_frame(np.full(3, np.nan), "left"),
    "a force of booleans": lambda: to_finger_frame(np.array([True, False, True]), "left"),
    "a force of objects": lambda: to_finger_frame(np.array([1, 2, None], object), "left"),
    "a force of words": lambda: to_finger_frame(np.array(["a", "b", "c"]), "left"),
    "a force of torch's bytes": lambda: to_finger_frame(torch.ones(3, dtype=torch.uint8), "right"),
    "a force in a list": lambda: to_finger_frame([1.0, 2.0, 3.0], "left"),
}


def head(tokenizer):
    return ForceHead(ForceRegressor(HeadConfig(hidden=2, mlp=2)), "tactip", tokenizer.hash)


def uskin():
    canonicalizer = Canonicalizer("uskin")
    canonicalizer.set_reference(SCAN)
    return canonicalizer


@pytest.mark.parametrize("name", IMAGES)
def test_images_that_cannot_be(name, tokenizer, dots):
    with pytest.raises(UniForceError, match="expected"):
        IMAGES[name](tokenizer, dots)


@pytest.mark.parametrize("name", COUNTS)
def test_counts_and_forces_that_cannot_be(name):
    with pytest.raises(UniForceError, match="expected"):
        COUNTS[name]()
