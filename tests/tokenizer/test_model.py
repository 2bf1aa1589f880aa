from dataclasses import replace

import pytest
import torch

from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.attention import CausalPairAttention
from uniforce_vtla.tokenizer.model import build_model, warped
from uniforce_vtla.tokenizer.settings import TokenizerConfig


def images(count, seed=0):
    return torch.rand(count, 1, 32, 32, generator=torch.Generator().manual_seed(seed))


def masked_pair(attention, tokens):
    """The definition: attention over (B, 2, P, D) with a lower-triangular mask, by a generic softmax."""
    B, T, P, D = tokens.shape
    heads = attention.heads
    qkv = attention.qkv(attention.norm(tokens)).view(B, T, P, 3, heads, D // heads)
    q, k, v = qkv.unbind(3)  # (B, T, P, heads, d)
    scores = torch.einsum("btphd,bsphd->bphts", q, k) * (D // heads) ** -0.5
    scores = scores.masked_fill(~torch.ones(T, T, dtype=torch.bool).tril(), -torch.inf)
    mixed = torch.einsum("bphts,bsphd->btphd", scores.softmax(-1), v).reshape(B, T, P, D)
    return tokens + attention.out(mixed)


def test_written_out_temporal_attention_is_the_masked_softmax():
    torch.manual_seed(0)
    attention = CausalPairAttention(16, 2)
    tokens = torch.randn(3, 2, 5, 16)
    wanted = masked_pair(attention, tokens)
    reference, past = attention.reference(tokens[:, 0])
    torch.testing.assert_close(reference, wanted[:, 0], atol=1e-5, rtol=0)
    torch.testing.assert_close(
        attention.current(tokens[:, 1], past), wanted[:, 1], atol=1e-5, rtol=0
    )


def test_current_depends_on_reference_and_never_the_other_way(tiny):
    model = build_model(tiny, 0)
    reference = images(1).requires_grad_()
    current = images(1, 1).requires_grad_()
    cache = model.encoder.encode_reference(reference)
    kept = sum(k.sum() + v.sum() for k, v in cache.kept)
    assert torch.autograd.grad(kept, current, allow_unused=True, retain_graph=True)[0] is None
    mean = model(reference, current).mean.square().sum()
    from_reference, from_current = torch.autograd.grad(mean, (reference, current))
    assert from_reference.abs().max() > 0 and from_current.abs().max() > 0


def test_cached_path_equals_full_path(tiny):
    model = build_model(tiny, 0)
    reference, current = images(1), images(4, 1)
    cache = model.encoder.encode_reference(reference)
    for i in range(4):
        cached = model.encoder.encode_current(cache, current[i : i + 1])
        full = model(reference, current[i : i + 1])
        torch.testing.assert_close(cached.mean, full.mean, atol=1e-5, rtol=0)
    at_once = model.encoder.encode_current(cache, current).mean
    each = model(reference.expand(4, -1, -1, -1), current).mean
    torch.testing.assert_close(at_once, each, atol=1e-5, rtol=0)
    repeated = model.encoder.encode_current(cache.repeat(4), current).mean
    torch.testing.assert_close(repeated, each, atol=1e-5, rtol=0)


@pytest.mark.parametrize("motion_scales", [0, 3])
@pytest.mark.parametrize("embed_hidden", [0, 16])
def test_shapes_with_and_without_options(motion_scales, embed_hidden):
    options = {"motion_scales": motion_scales, "embed_hidden": embed_hidden}
    config = TokenizerConfig(side=32, patch=8, width=16, depth=1, heads=2, **options)
    model = build_model(config, 0)
    posterior = model(images(2), images(2, 1))
    assert posterior.mean.shape == posterior.log_variance.shape == (2, config.num_patches, 6)
    assert model.decoder(images(2), posterior.sample()).shape == (2, 1, 32, 32)


def test_same_seed_same_weights_and_global_generator_untouched(tiny):
    torch.manual_seed(3)
    before = torch.random.get_rng_state()
    first, second = build_model(tiny, 5), build_model(tiny, 5)
    assert torch.equal(torch.random.get_rng_state(), before)
    assert all(
        torch.equal(a, b) for a, b in zip(first.parameters(), second.parameters(), strict=True)
    )


@pytest.mark.parametrize("wrong", [{"side": 33}, {"heads": 3}, {"width": 18, "heads": 3}])
def test_sizes_that_do_not_divide_raise(wrong):
    with pytest.raises(ContractError):
        TokenizerConfig(**wrong)


def test_flow_moves_pixels_and_starts_at_rest(tiny):
    image = torch.rand(2, 1, 32, 32)
    assert torch.allclose(warped(image, torch.zeros(2, 2, 32, 32)), image, atol=1e-5)
    right = torch.zeros(2, 2, 32, 32)
    right[:, 0] = -3.0  # what is seen came from three pixels to the left
    assert torch.allclose(warped(image, right)[..., 3:], image[..., :-3], atol=1e-5)
    model = build_model(replace(tiny, warp=True), seed=0)
    drawn = model.decoder(image, torch.randn(2, tiny.num_patches, tiny.latent))
    plain = build_model(tiny, seed=0).decoder
    assert drawn.shape == image.shape and not any("flow" in name for name in plain.state_dict())


def test_options_added_later_are_off_and_leave_older_hashes_alone(tiny):
    assert "warp" not in tiny.facts()
    assert replace(tiny, warp=True).facts()["warp"] is True
