"""Loss of pretraining: four reconstructions, KL, equilibrium. No force label anywhere.

UniForce paper, section "Objective Function"; the paper gives no λ, ours are measured starts.
"""

from dataclasses import dataclass

import torch
from torch.nn import functional as F  # noqa: N812

from uniforce_vtla.tokenizer.latent import POOL, pool_latent
from uniforce_vtla.tokenizer.model import Decoder, Posterior
from uniforce_vtla.tokenizer.settings import LossConfig

# regions per side; None = every patch
LEVELS: dict[str, tuple[int | None, ...]] = {"patch": (None,), "levels": (None, POOL, 1)}


@dataclass(frozen=True)
class Side:
    """One finger's prepared images, (B, 1, S, S) each, and the posterior inferred from them."""

    reference: torch.Tensor
    current: torch.Tensor
    posterior: Posterior


def objective(
    decoder: Decoder, left: Side, right: Side, config: LossConfig, step: int, per_unit: int = 1
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """Return the loss and its parts for one batch of pairs, ``per_unit`` contacts of each unit.

    ``copied`` among the parts is the score of the reference itself in all four branches. A model
    that scores no better has learnt nothing.
    """
    z_left = left.posterior.sample()
    z_right = right.posterior.sample()
    # four branches, from whose latent to whose image, in one pass of the decoder
    references = torch.cat([left.reference, right.reference, left.reference, right.reference])
    drawn = decoder(references, torch.cat([z_left, z_left, z_right, z_right]))
    left_left, left_right, right_left, right_right = drawn.chunk(4)  # (B, 1, S, S) each
    parts = {
        "recon_LL": reconstruction(left_left, left, config),
        "recon_LR": reconstruction(left_right, right, config),
        "recon_RL": reconstruction(right_left, left, config),
        "recon_RR": reconstruction(right_right, right, config),
    }
    recon = torch.stack(list(parts.values())).sum()
    parts["kl"] = kl(left.posterior) + kl(right.posterior)
    parts["equilibrium"] = equilibrium(z_left, z_right, config, per_unit)
    with torch.no_grad():
        copied_left = reconstruction(left.reference, left, config)
        copied_right = reconstruction(right.reference, right, config)
        parts["copied"] = 2 * (copied_left + copied_right)
    warmup = min(1.0, (step + 1) / max(1, config.equilibrium_warmup_steps))
    pull = config.equilibrium_weight * warmup
    return recon + config.kl_weight * parts["kl"] + pull * parts["equilibrium"], parts


def reconstruction(drawn: torch.Tensor, truth: Side, config: LossConfig) -> torch.Tensor:
    """Return weighted L1 + λ·perceptual of one branch.

    Markers are sparse: plain L1 is content to copy the reference. Changed pixels may count more.
    """
    change = (truth.current - truth.reference).abs()
    weight = 1 + config.changed_pixel_weight * change  # (B, 1, S, S)
    l1 = (weight * (drawn - truth.current).abs()).mean()
    perceptual = gradient_pyramid(drawn, truth.current, config.pyramid_levels)
    return (l1 + config.perceptual_weight * perceptual) * config.pixels_per_patch


def kl(posterior: Posterior) -> torch.Tensor:
    """Return KL(q ‖ N(0, 1)), mean over the latent's numbers."""
    mean, log_variance = posterior
    return 0.5 * (mean**2 + log_variance.exp() - 1 - log_variance).mean()


def equilibrium(
    z_left: torch.Tensor, z_right: torch.Tensor, config: LossConfig, per_unit: int = 1
) -> torch.Tensor:
    """Return ‖z_L − z_R‖² / P by patch (paper), or added to the same of regions and of the total.

    ``per_unit``: rows (B, P, L) come unit by unit, so many contacts of each.
    """
    if config.equilibrium_scale == "per_unit":
        z_left = _in_own_units(z_left, per_unit)
        z_right = _in_own_units(z_right, per_unit)
    errors = []
    for grid in LEVELS[config.equilibrium]:
        left = z_left
        right = z_right
        if grid is not None:
            left = pool_latent(z_left, grid)
            right = pool_latent(z_right, grid)
        errors.append((left - right).square().sum(-1).mean(1))  # (B,)
    return torch.stack(errors).sum(dim=0).mean()


def _in_own_units(z: torch.Tensor, per_unit: int) -> torch.Tensor:
    """Return (B, P, L) divided by each unit's root mean square.

    The RMS isn't detached; otherwise shrinking latents would lower the loss.
    """
    by_unit = z.unflatten(0, (-1, per_unit))
    size = by_unit.square().mean(dim=(1, 2, 3), keepdim=True).sqrt()
    return (by_unit / size.clamp_min(1e-6)).flatten(0, 1)


def gradient_pyramid(drawn: torch.Tensor, truth: torch.Tensor, levels: int) -> torch.Tensor:
    """Return the mean L1 between image gradients at ``levels`` scales, each half the last."""
    total = drawn.new_zeros(())
    # finite differences and averaging are linear: one pass over the error is enough
    error = drawn - truth
    for _ in range(levels):
        total = total + error.diff(dim=-1).abs().mean() + error.diff(dim=-2).abs().mean()
        error = F.avg_pool2d(error, 2)
    return total / levels
