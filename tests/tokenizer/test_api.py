from __future__ import annotations

import numpy as np
import pytest
import torch

from uniforce_vtla.contracts import MarkerPair
from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.api import CACHED_REFERENCES, Tokenizer
from uniforce_vtla.tokenizer.model import TokenizerConfig


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


def test_reference_cache_goes_by_content_and_stays_small(tokenizer: Tokenizer, dots: np.ndarray) -> None:
    first = tokenizer.encode(dots[:1], dots[1:2])
    assert not torch.allclose(first, tokenizer.encode(dots[2:], dots[1:2]))
    torch.testing.assert_close(tokenizer.encode(dots[:1].copy(), dots[1:2]), first)
    changed = dots[:1].copy()
    tokenizer.encode(changed, dots[1:2])
    changed[0, :48] = 0  # same array object, other content
    assert not torch.allclose(tokenizer.encode(changed, dots[1:2]), first)
    for i in range(2 * CACHED_REFERENCES):
        tokenizer.encode(np.roll(dots[:1], i, axis=2), dots[1:2])
    assert len(tokenizer._references) <= CACHED_REFERENCES


def test_decode_has_the_models_size(tokenizer: Tokenizer, dots: np.ndarray) -> None:
    image = tokenizer.decode(dots[:1], tokenizer.encode(dots[:1], dots))
    assert image.shape == (3, 32, 32) and image.min() >= 0 and image.max() <= 1


def test_bad_calls_raise(tokenizer: Tokenizer, dots: np.ndarray) -> None:
    calls = (
        lambda: tokenizer.encode(dots[:1]),  # type: ignore[call-overload]
        lambda: tokenizer.encode(dots[:2], dots),
        lambda: tokenizer.encode(dots[:1], dots, finger="middle"),  # type: ignore[call-overload]
        lambda: tokenizer.encode(np.zeros_like(dots[:1]), dots),
        lambda: tokenizer.encode(dots[:1], dots.astype(np.float32)),
        lambda: tokenizer.encode("reference", dots),  # type: ignore[call-overload]
    )
    for call in calls:
        with pytest.raises(ContractError, match="expected"):
            call()
