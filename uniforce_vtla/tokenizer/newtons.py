"""Newtons: calibrated pooled latents → fx, fy, fz, by the frozen head, a gain and a held grip.

A flat gel that a tool covers shows shear but hardly grip. A policy learns both together: with a
sensor that reads too little grip it squeezes and presses harder than it was shown. A hand that
holds a tool keeps its grip, so a stored value serves once the tool is lifted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from uniforce_vtla.tokenizer.calibration import Calibration
    from uniforce_vtla.tokenizer.force_head import ForceRegressor

TOUCHES_N = 1.0  # grip from which on something is between the fingers
LIFT_m = (
    0.02  # above the lowest height at which it was touched: it is in the hand, not on the table
)
# grip from which on something is held: free air reads up to .3 N, the least calibrated GelSight 3 N
GRIPPED_N = 2.0
FZ = 2  # of a reading's fx, fy, fz


class Lift:
    """Tells when the touched object was lifted; one row for each environment."""

    def __init__(self) -> None:
        self._seen: tuple[Tensor, Tensor] | None = None  # (B,) lowest touched height, is lifted

    def see(self, height_m: Tensor, grip_N: Tensor) -> Tensor:
        """Return (B,) bool, touched now and lifted before, for the hand's (B,) height and grip."""
        if self._seen is None or len(self._seen[0]) != len(height_m):
            nowhere_m = torch.full_like(height_m, torch.inf)
            self._seen = (nowhere_m, torch.zeros_like(height_m, dtype=torch.bool))
        lowest_m, is_lifted = self._seen
        touches = grip_N > TOUCHES_N
        lowest_m = torch.where(touches, torch.minimum(lowest_m, height_m), torch.inf)
        is_lifted = is_lifted | (touches & (height_m > lowest_m + LIFT_m))
        self._seen = (lowest_m, is_lifted)
        return is_lifted & touches


class Newtons:
    """Reads newtons in a finger's calibrated pooled latents.

    Args:
        head: frozen force head.
        calibration: whose gain is applied; None for none.
        held_N: grip that is given once lifted; None gives the grip that is read.
        from_touch: give it from the first touch on instead, for a hand that holds by its own force.
    """

    def __init__(
        self,
        head: ForceRegressor,
        calibration: Calibration | None = None,
        held_N: float | None = None,
        from_touch: bool = False,
    ) -> None:
        self.head = head
        self.calibration = calibration
        self.held_N = held_N
        self.from_touch = from_touch
        self.reset()

    def reset(self) -> None:
        """Start an episode."""
        self._lift = Lift()

    @torch.no_grad()
    def read(self, latent: Tensor) -> Tensor:
        """Return (B, 3) N, canonical frame, of (B, K, L) latents, with the grip that is read."""
        force_N = self.head.step(latent, None)[0]  # (B, 3)
        if self.calibration is not None:
            force_N = self.calibration.scaled(force_N)
        return force_N

    @torch.no_grad()
    def __call__(self, latent: Tensor, height_m: Tensor | None = None) -> Tensor:
        """Return (B, 3) N, canonical frame, of (B, K, L) latents.

        ``height_m`` is the hand's (B,) height; without it the grip is given as read.
        """
        force_N = self.read(latent)
        if self.held_N is None:
            return force_N
        grip_N = force_N[:, FZ]
        if self.from_touch:
            is_held = grip_N > GRIPPED_N
        elif height_m is None:
            return force_N
        else:
            is_held = self._lift.see(height_m.to(grip_N), grip_N)
        held_N = torch.full_like(grip_N, self.held_N)
        force_N = force_N.clone()
        force_N[:, FZ] = torch.where(is_held, held_N, grip_N)
        return force_N
