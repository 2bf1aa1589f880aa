from dataclasses import replace

import pytest
import torch

from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.attention import CausalPairAttention
from uniforce_vtla.tokenizer.model import build_model, warped
from uniforce_vtla.tokenizer.settings import TokenizerConfig


def images(count, seed=0):
    return torch.rand(count, 1, 32, 32, generator=torch.Generator().manual_seed(seed))


def test_written_out_temporal_attention_is_the_masked_softmax():
    """The definition: a lower-triangular mask over (reference, current) of each patch."""
    torch.manual_seed(0)
    attention = CausalPairAttention(16, 2)
    tokens = torch.randn(3, 2, 5, 16)  # (B, 2, P, D)
    qkv = attention.qkv(attention.norm(tokens)).view(3, 2, 5, 3, 2, 8)
    q, k, v = qkv.permute(3, 0, 2, 4, 1, 5)  # (B, P, heads, 2, d) each
    mixed = torch.nn.functional.scaled_dot_product_attention(q, k, v, is_causal=True)
    wanted = tokens + attention.out(mixed.permute(0, 3, 1, 2, 4).reshape(3, 2, 5, 16))
    reference, past = attention.reference(tokens[:, 0])
    torch.testing.assert_close(reference, wanted[:, 0], atol=1e-5, rtol=0)
    current = attention.current(tokens[:, 1], past)
    torch.testing.assert_close(current, wanted[:, 1], atol=1e-5, rtol=0)


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
    each = model(reference.expand(4, -1, -1, -1), current).mean
    alone = [model.encoder.encode_current(cache, image[None]).mean for image in current]
    at_once = model.encoder.encode_current(cache, current).mean
    repeated = model.encoder.encode_current(cache.repeat(4), current).mean
    for cached in (torch.cat(alone), at_once, repeated):
        torch.testing.assert_close(cached, each, atol=1e-5, rtol=0)


@pytest.mark.parametrize("motion_scales", [0, 3])
@pytest.mark.parametrize("embed_hidden", [0, 16])
def test_shapes_with_and_without_options(motion_scales, embed_hidden):
    options = {"motion_scales": motion_scales, "embed_hidden": embed_hidden}
    config = TokenizerConfig(side=32, patch=8, width=16, depth=1, heads=2, **options)
    model = build_model(config, 0)
    posterior = model(images(2), images(2, 1))
    assert posterior.mean.shape == posterior.log_variance.shape == (2, config.num_patches, 6)
    assert model.decoder(images(2), posterior.sample()).shape == (2, 1, 32, 32)


def test_a_new_model_leaves_the_global_generator_alone(tiny):
    before = torch.random.get_rng_state()
    build_model(tiny, 5)
    assert torch.equal(torch.random.get_rng_state(), before)


@pytest.mark.parametrize("wrong", [{"side": 33}, {"heads": 3}, {"width": 18, "heads": 3}])
def test_sizes_that_do_not_divide_raise(wrong):
    with pytest.raises(ContractError):
        TokenizerConfig(**wrong)


def test_flow_moves_pixels_and_starts_at_rest(tiny):
    image = images(2)
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
