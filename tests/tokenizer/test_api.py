import gc
import sys

import numpy as np
import pytest
import torch

from uniforce_vtla.contracts import MarkerPair
from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig
from uniforce_vtla.tokenizer.force_head import ForceHead, ForceRegressor, HeadConfig


@pytest.fixture
def tokenizer(tiny):
    return Tokenizer.random(tiny)


def test_pair_and_arrays_agree(tokenizer, dots):
    pair = MarkerPair(dots[0], dots[1], "right", "tactip")
    z = tokenizer.encode(pair)
    assert z.shape == (1, tokenizer.num_patches, 6)
    assert z.dtype == torch.float32 and not z.requires_grad
    torch.testing.assert_close(z, tokenizer.encode(dots[:1], dots[1:2], finger="right"))


def test_mirror_contract(tokenizer, dots):
    flipped = np.ascontiguousarray(dots[:, :, ::-1])
    left = tokenizer.encode(dots[:1], dots[1:], "left")
    torch.testing.assert_close(tokenizer.encode(flipped[:1], flipped[1:], "right"), left)
    assert not torch.allclose(tokenizer.encode(flipped[:1], flipped[1:], "left"), left)


def test_batch_equals_one_by_one_and_one_reference_serves_all(tokenizer, dots):
    together = tokenizer.encode(dots[:1], dots)
    alone = torch.cat([tokenizer.encode(dots[:1], dots[i : i + 1]) for i in range(3)])
    torch.testing.assert_close(together, alone, atol=1e-5, rtol=0)
    torch.testing.assert_close(tokenizer.encode(dots[[0, 0, 0]], dots), together, atol=1e-5, rtol=0)


def test_decode_has_the_models_size(tokenizer, dots):
    image = tokenizer.decode(dots[:1], tokenizer.encode(dots[:1], dots))
    assert image.shape == (3, 32, 32) and image.min() >= 0 and image.max() <= 1


def test_memory_stays_flat_over_two_thousand_frames(dots):
    tokenizer = Tokenizer.random(
        TokenizerConfig(side=32, patch=8, width=8, depth=1, heads=1, embed_hidden=0)
    )
    head = ForceHead(ForceRegressor(HeadConfig(hidden=2, mlp=2)), "tactip", tokenizer.hash)
    small = dots[:, ::2, ::2]
    state = None
    for frame in range(2_050):
        if frame == 50:
            tensors, blocks = live_tensors(), sys.getallocatedblocks()
        current = np.roll(small[1:2], frame % 7, axis=2)
        _, state = head.step(tokenizer.encode(small[:1], current, "right"), state)
    assert live_tensors() <= tensors
    assert sys.getallocatedblocks() - blocks < 1_000  # one object kept per frame would be 2,000


def live_tensors():
    gc.collect()
    return sum(value.numel() for value in gc.get_objects() if type(value) is torch.Tensor)


@pytest.mark.parametrize("fill", [0.0, np.nan])
def test_a_reference_without_markers_is_refused(tokenizer, dots, fill):
    with pytest.raises(ContractError, match="reference"):
        tokenizer.encode(np.full(dots[:1].shape, fill, np.float32), dots[1:2])
