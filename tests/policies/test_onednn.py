"""oneDNN's products against torch's own: same numbers within float32's rounding, and only where they may run."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.sampler import onednn
from lerobot_policy_pi05_uniforce.sampler.layers import embed_cameras
from lerobot_policy_pi05_uniforce.sampler.onednn import on_intel as real_on_intel

CLOSE = {"rtol": 1e-5, "atol": 1e-5}


@pytest.fixture(autouse=True)
def on_amd(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onednn, "on_intel", lambda: False)


@torch.no_grad()
def test_products_and_their_epilogues_are_torchs() -> None:
    x, w, b, other = torch.randn(2, 7, 24), torch.randn(16, 24) / 5, torch.randn(16), torch.randn(2, 7, 16)
    plain = F.linear(x, w)
    torch.testing.assert_close(onednn.linear(x, w, b), plain + b, **CLOSE)
    torch.testing.assert_close(onednn.linear_gelu(x, w, b), F.gelu(plain + b, approximate="tanh"), **CLOSE)
    torch.testing.assert_close(onednn.linear_times(x, w, other), plain * other, **CLOSE)
    torch.testing.assert_close(onednn.linear_plus(x, w, b, other), plain + b + other, **CLOSE)


@torch.no_grad()
@pytest.mark.parametrize("rows", [0, 1, 50])
def test_attention_in_one_product_is_torchs(rows: int) -> None:
    q, cache = torch.randn(1, 8, 50, 16), torch.randn(1, 2, 300, 16)
    mask = None if rows == 0 else torch.rand(1, 1, rows, 300) > 0.3
    k, v = (cache[:, n : n + 1].expand(-1, 8, -1, -1) for n in (0, 1))
    wanted = F.scaled_dot_product_attention(q, k, v, attn_mask=mask, scale=1.0)
    torch.testing.assert_close(onednn.attend_one(q, cache[0, 0], cache[0, 1], mask), wanted, **CLOSE)


def test_where_a_gradient_is_wanted_torch_runs() -> None:
    x, w = torch.randn(3, 8), torch.randn(4, 8, requires_grad=True)
    assert not onednn.here(x)
    onednn.linear_gelu(x, w).sum().backward()
    assert w.grad is not None and bool(w.grad.abs().max() > 0)
    with torch.no_grad():
        assert not onednn.here(x.bfloat16()) and onednn.here(x) == onednn.AVAILABLE


@torch.no_grad()
def test_cameras_are_seen_as_transformers_sees_them(make_policy) -> None:
    model = make_policy(touch__input="none").model.paligemma_with_expert
    for norm in (m for m in model.modules() if isinstance(m, nn.LayerNorm)):
        nn.init.normal_(norm.weight), nn.init.normal_(norm.bias)
    images = torch.rand(3, 3, 28, 28) * 2 - 1
    wanted = model.embed_image(images)
    assert wanted.abs().max() > 0.01
    torch.testing.assert_close(embed_cameras(model.paligemma.model, images), wanted, **CLOSE)


@pytest.mark.parametrize("bias", [True, False])
def test_gradients_of_a_layer_are_torchs(bias: bool) -> None:
    plain = nn.Linear(24, 16, bias=bias)
    quick = nn.Linear(24, 16, bias=bias)
    quick.load_state_dict(plain.state_dict())
    holder = nn.Sequential(quick)
    onednn.use_onednn(holder)
    quick = holder[0]
    assert isinstance(quick, onednn.OneDnnLinear) and quick.state_dict().keys() == plain.state_dict().keys()
    found = []
    for layer in (plain, quick):
        torch.manual_seed(0)
        x = torch.randn(2, 7, 24, requires_grad=True)
        out = layer(x.transpose(0, 1))  # whose rows don't lie one after another
        (out.transpose(0, 1) * torch.randn(2, 7, 16)).sum().backward()
        found.append([out, x.grad, *(weight.grad for weight in layer.parameters())])
    for ours, torchs in zip(found[1], found[0], strict=True):
        torch.testing.assert_close(ours, torchs, **CLOSE)


def test_on_intel_training_stays_with_mkl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onednn, "on_intel", lambda: True)
    holder = nn.Sequential(nn.Linear(8, 4))
    onednn.use_onednn(holder)
    assert type(holder[0]) is nn.Linear


@pytest.mark.parametrize(("content", "intel"), [("vendor_id\t: GenuineIntel\n", True), ("CPU part\n", False)])
def test_the_vendor_is_what_the_system_says(content: str, intel: bool, tmp_path: Path) -> None:
    assert not real_on_intel(tmp_path / "cpuinfo")
    (tmp_path / "cpuinfo").write_text(content)
    assert real_on_intel(tmp_path / "cpuinfo") == intel


def test_frozen_weights_and_other_dtypes_are_left_alone() -> None:
    layer = onednn.OneDnnLinear(nn.Linear(8, 4)).requires_grad_(False)
    x = torch.randn(3, 8, requires_grad=True)
    layer(x).sum().backward()
    assert x.grad is not None and layer.weight.grad is None
    torch.testing.assert_close(x.grad, layer.weight.sum(dim=0).expand(3, 8), **CLOSE)
    assert layer.double()(x.double()).dtype == torch.float64
