"""Projections on a CPU by oneDNN: same float32 products, another library and fused epilogues.

torch sends a float32 ``linear`` to MKL, which on AMD processors runs at half of oneDNN's speed, and its tanh GELU takes
as long as the product before it (docs/experiments/policy_speed.md). On Intel the products of training stay with MKL.
Where oneDNN is missing, on another device, in another dtype, or where torch.compile traces, torch runs; results agree
within rounding. The fused ones are for sampling: where a gradient is wanted (RTC's guidance) torch runs too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

AVAILABLE = torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, "_linear_pointwise")
CPUINFO = Path("/proc/cpuinfo")
# of attention: fewer aren't worth five operations, more leave the cache, and torch's tiled attention wins
SCORES = (2**16, 2**20)


def on_intel(cpuinfo: Path = CPUINFO) -> bool:
    """Return whether the system says that this is an Intel processor."""
    return cpuinfo.is_file() and "GenuineIntel" in cpuinfo.read_text()


def takes(x: Tensor) -> bool:
    """Return whether oneDNN can take this tensor's products."""
    wanted = x.device.type == "cpu" and x.dtype == torch.float32
    return AVAILABLE and wanted and not torch.compiler.is_compiling()


def here(x: Tensor) -> bool:
    """Return whether oneDNN takes this tensor's products where no gradient is wanted."""
    return takes(x) and not torch.is_grad_enabled()


def linear(x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """Return ``x`` (…, K) times ``weight`` (N, K) transposed, plus ``bias`` (N,)."""
    return _product(x, weight, bias) if here(x) else F.linear(x, weight, bias)


def linear_gelu(x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """Return the tanh GELU of :func:`linear`."""
    if not here(x):
        return F.gelu(F.linear(x, weight, bias), approximate="tanh")
    return torch.ops.mkldnn._linear_pointwise(x, weight, bias, "gelu", [], "tanh")


def linear_times(x: Tensor, weight: Tensor, factor: Tensor) -> Tensor:
    """Return :func:`linear` times ``factor`` (…, N)."""
    if not here(x):
        return F.linear(x, weight) * factor
    return torch.ops.mkldnn._linear_pointwise.binary(x, factor, weight, None, "mul")


def linear_plus(x: Tensor, weight: Tensor, bias: Tensor | None, summand: Tensor) -> Tensor:
    """Return :func:`linear` plus ``summand`` (…, N), a residual stream."""
    if not here(x):
        return F.linear(x, weight, bias) + summand
    return torch.ops.mkldnn._linear_pointwise.binary(x, summand, weight, bias, "add")


def gated_hidden(mlp: nn.Module, x: Tensor) -> Tensor:
    """Return the hidden layer of Gemma's MLP, gelu(gate) · up."""
    return linear_times(x, mlp.up_proj.weight, linear_gelu(x, mlp.gate_proj.weight))


def suits(q: Tensor, keys: int) -> bool:
    """Return whether :func:`attend_one` is the faster way for (B, heads, L, head) queries."""
    return here(q) and len(q) == 1 and SCORES[0] <= q.shape[1] * q.shape[2] * keys <= SCORES[1]


def attend_one(q: Tensor, k: Tensor, v: Tensor, mask: Tensor | None) -> Tensor:
    """Return attention (1, heads, L, head) of a batch of one, all heads in one product.

    Args:
        q: (1, heads, L, head), scaled.
        k: (L_keys, head), shared by all heads, as ``v`` is.
        v: (L_keys, head).
        mask: (1, 1, 1 or L, L_keys), bool (True is seen) or additive, or None.
    """
    scores = linear(q.flatten(0, 2), k)  # (heads·L, L_keys)
    if mask is not None:
        apart = scores.view(*q.shape[:3], -1)
        apart.masked_fill_(~mask, -torch.inf) if mask.dtype == torch.bool else apart.add_(mask)
    return linear(scores.softmax(dim=-1), v.t()).view(q.shape)


def _product(x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    return torch.ops.mkldnn._linear_pointwise(x, weight, bias, "none", [], "")


class _Product(torch.autograd.Function):
    """``linear`` with a gradient: all three products by oneDNN."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        ctx.save_for_backward(x, weight)
        return _product(x, weight, bias)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Any:  # type: ignore[override]
        x, weight = ctx.saved_tensors
        of_x, of_weight, of_bias = ctx.needs_input_grad
        rows = grad.reshape(-1, grad.shape[-1])  # (M, N)
        return (
            _product(grad.contiguous(), weight.t()) if of_x else None,
            _product(rows.t(), x.reshape(-1, x.shape[-1]).t()) if of_weight else None,
            rows.sum(dim=0) if of_bias else None,
        )


class OneDnnLinear(nn.Linear):
    """An ``nn.Linear``, with its parameters, that trains by oneDNN; without gradients it stays torch's."""

    def __init__(self, plain: nn.Linear) -> None:
        super().__init__(plain.in_features, plain.out_features, plain.bias is not None, device="meta")
        self.weight, self.bias = plain.weight, plain.bias

    def forward(self, x: Tensor) -> Tensor:
        """Return (…, N) of (…, K)."""
        if not (takes(x) and torch.is_grad_enabled()):
            return super().forward(x)
        return _Product.apply(x, self.weight, self.bias)


def use_onednn(module: nn.Module) -> None:
    """Let every plain ``nn.Linear`` inside a module train by oneDNN, but on Intel; weights and their names stay."""
    for owner in [] if on_intel() else list(module.modules()):
        for name, part in owner.named_children():
            if type(part) is nn.Linear:
                setattr(owner, name, OneDnnLinear(part))
