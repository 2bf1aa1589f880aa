"""Material variables: what a unit's other contacts tell of its stiffness and gain, for the forward model alone.

A reference image doesn't show how soft a gel is, so without them the decoder blames every unit's softness on z.  They
are inferred during pretraining from the *other* contacts of the same unit and the force latents its partner felt
there; the encoder never sees them, and z means the same with and without.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

HIDDEN = 32  # units of both layers; a handful of numbers comes out


class MaterialEncoder(nn.Module):
    """How images changed under which latents → a few numbers per contact's unit."""

    def __init__(self, patch: int, latent: int, material: int) -> None:
        super().__init__()
        self.patch = patch
        self.look = nn.Sequential(nn.Linear(2 * patch**2 + latent, HIDDEN), nn.GELU())
        self.tell = nn.Sequential(nn.Linear(2 * HIDDEN, HIDDEN), nn.GELU(), nn.Linear(HIDDEN, material))

    def forward(
        self, reference: torch.Tensor, current: torch.Tensor, z_partner: torch.Tensor, per_unit: int
    ) -> torch.Tensor:
        """Return (U·n, material) for each contact, from the unit's ``n`` − 1 others; zeros where n is 1.

        Args:
            reference: (U·n, 1, S, S), each unit's repeated.
            current: (U·n, 1, S, S), unit by unit.
            z_partner: (U·n, P, latent) what the other finger felt; taken as given.
            per_unit: n.
        """
        change = F.unfold(current - reference, self.patch, stride=self.patch).transpose(
            1, 2
        )  # (B, P, patch²)
        before = F.unfold(reference, self.patch, stride=self.patch).transpose(1, 2)
        seen = self.look(torch.cat([change, before, z_partner.detach()], dim=2))  # (B, P, H)
        summary = torch.cat([seen.mean(dim=1), seen.amax(dim=1)], dim=1)  # (B, 2·H)
        return mean_of_others(self.tell(summary), per_unit)


def mean_of_others(values: torch.Tensor, per_unit: int) -> torch.Tensor:
    """Return (U·n, M): per row the mean over its unit's other rows; a contact must not tell about itself."""
    grouped = values.unflatten(0, (-1, per_unit))  # (U, n, M)
    others = grouped.sum(dim=1, keepdim=True) - grouped
    return (others / max(1, per_unit - 1)).flatten(0, 1)
