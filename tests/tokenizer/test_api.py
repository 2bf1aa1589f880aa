import gc
import sys

import numpy as np
import pytest
import torch

from uniforce_vtla.contracts import FINGERS, Finger, MarkerPair
from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig
from uniforce_vtla.tokenizer.force_head import ForceHead, ForceRegressor, HeadConfig
from uniforce_vtla.tokenizer.streaming import StreamingEncoder


@pytest.fixture
def tokenizer(tiny: TokenizerConfig) -> Tokenizer:
    return Tokenizer.random(tiny)


def test_pair_and_arrays_agree(tokenizer: Tokenizer, dots: np.ndarray) -> None:
    pair = MarkerPair(dots[0], dots[1], "right", "tactip")
    z = tokenizer.encode(pair)
    assert z.shape == (1, tokenizer.num_patches, 6) and z.dtype == torch.float32 and not z.requires_grad
    torch.testing.assert_close(z, tokenizer.encode(dots[:1], dots[1:2], finger="right"))


def test_mirror_contract(tokenizer: Tokenizer, dots: np.ndarray) -> None:
    flipped = np.ascontiguousarray(dots[:, :, ::-1])
    left = tokenizer.encode(dots[:1], dots[1:], "left")
    torch.testing.assert_close(tokenizer.encode(flipped[:1], flipped[1:], "right"), left)
    assert not torch.allclose(tokenizer.encode(flipped[:1], flipped[1:], "left"), left)


def test_batch_equals_one_by_one_and_one_reference_serves_all(tokenizer: Tokenizer, dots: np.ndarray) -> None:
    together = tokenizer.encode(dots[:1], dots)
    alone = torch.cat([tokenizer.encode(dots[:1], dots[i : i + 1]) for i in range(3)])
    torch.testing.assert_close(together, alone, atol=1e-5, rtol=0)
    torch.testing.assert_close(tokenizer.encode(dots[[0, 0, 0]], dots), together, atol=1e-5, rtol=0)


def test_decode_has_the_models_size(tokenizer: Tokenizer, dots: np.ndarray) -> None:
    image = tokenizer.decode(dots[:1], tokenizer.encode(dots[:1], dots))
    assert image.shape == (3, 32, 32) and image.min() >= 0 and image.max() <= 1


@pytest.fixture
def head(tokenizer: Tokenizer) -> ForceHead:
    torch.manual_seed(0)
    return ForceHead(ForceRegressor(HeadConfig()), "tactip", tokenizer.hash)


@pytest.mark.parametrize("finger", FINGERS)
def test_stream_equals_batch(tokenizer: Tokenizer, head: ForceHead, dots: np.ndarray, finger: Finger) -> None:
    encoder, other = (StreamingEncoder(tokenizer, finger, head) for _ in range(2))
    for stream in (encoder, other):
        stream.set_reference(dots[0])
    frames = dots[[1, 2, 0, 1]]
    steps = [(encoder.step(frame), other.step(dots[2]))[0] for frame in frames]  # they share nothing
    batch = tokenizer.encode(dots[:1], frames, finger)
    torch.testing.assert_close(torch.stack([s.latent for s in steps]), batch, atol=1e-5, rtol=0)
    forces = np.stack([s.force_N for s in steps])
    np.testing.assert_allclose(forces, head.sequence(batch[None])[0].numpy(), atol=1e-5)
    assert np.abs(forces[0] - forces[3]).max() > 1e-4  # same frame, other history


def test_new_reference_forgets_the_past(tokenizer: Tokenizer, head: ForceHead, dots: np.ndarray) -> None:
    encoder = StreamingEncoder(tokenizer, "left", head)
    encoder.set_reference(dots[0])
    first, second = encoder.step(dots[1]), encoder.step(dots[1])
    assert not np.array_equal(first.force_N, second.force_N)
    encoder.set_reference(dots[0])
    again = encoder.step(dots[1])
    np.testing.assert_array_equal(again.force_N, first.force_N)
    encoder.set_reference(dots[2])
    assert not torch.equal(encoder.step(dots[1]).latent, first.latent)


def test_the_reference_is_encoded_once(tokenizer: Tokenizer, dots: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    original = tokenizer.model.encoder.encode_reference
    encoder = tokenizer.model.encoder
    monkeypatch.setattr(encoder, "encode_reference", lambda image: calls.append(1) or original(image))
    encoder = StreamingEncoder(tokenizer, "left")
    encoder.set_reference(dots[0])
    assert all(encoder.step(dots[1]).force_N is None for _ in range(5)), "without a head there is no force"
    assert len(calls) == 1


def test_memory_stays_flat_over_two_thousand_frames(dots: np.ndarray) -> None:
    tokenizer = Tokenizer.random(TokenizerConfig(side=32, patch=8, width=8, depth=1, heads=1, embed_hidden=0))
    head = ForceHead(ForceRegressor(HeadConfig(hidden=2, mlp=2)), "tactip", tokenizer.hash)
    encoder = StreamingEncoder(tokenizer, "right", head)
    dots = dots[:, ::2, ::2]
    encoder.set_reference(dots[0])
    run(encoder, dots, 50)
    tensors, blocks = live_tensors(), sys.getallocatedblocks()
    run(encoder, dots, 2_000)
    assert live_tensors() == tensors
    assert sys.getallocatedblocks() - blocks < 1_000  # one object kept per frame would be 2,000


def run(encoder: StreamingEncoder, dots: np.ndarray, frames: int) -> None:
    for i in range(frames):
        encoder.step(np.roll(dots[1], i % 7, axis=1))


def live_tensors() -> int:
    gc.collect()
    return sum(value.numel() for value in gc.get_objects() if type(value) is torch.Tensor)


def test_bad_frames_are_refused_and_change_nothing(tokenizer: Tokenizer, head: ForceHead, dots: np.ndarray) -> None:
    encoder, clean = (StreamingEncoder(tokenizer, "left", head) for _ in range(2))
    for stream in (encoder, clean):
        stream.set_reference(dots[0])
        stream.step(dots[1])
    nan = np.full(dots[0].shape, np.nan, np.float32)
    for bad in (nan, dots[1][:48], dots, dots[1].astype(np.int32), None):
        with pytest.raises(ContractError, match="expected"):
            encoder.step(bad)  # type: ignore[arg-type]
    np.testing.assert_array_equal(encoder.step(dots[2]).force_N, clean.step(dots[2]).force_N)


@pytest.mark.parametrize("fill", [0.0, np.nan])
def test_a_refused_reference_leaves_none(tokenizer: Tokenizer, dots: np.ndarray, fill: float) -> None:
    encoder = StreamingEncoder(tokenizer, "left")
    encoder.set_reference(dots[0])
    with pytest.raises(ContractError, match="reference"):
        encoder.set_reference(np.full(dots[0].shape, fill, np.float32))
    with pytest.raises(ContractError, match="set_reference"):
        encoder.step(dots[1])


def test_a_foreign_head_or_finger_is_refused(tokenizer: Tokenizer) -> None:
    with pytest.raises(CheckpointError, match="head"):
        StreamingEncoder(tokenizer, "left", ForceHead(ForceRegressor(HeadConfig()), "tactip", "other"))
    with pytest.raises(ContractError, match="finger"):
        StreamingEncoder(tokenizer, "thumb")  # type: ignore[arg-type]
