"""The measured state → one prefix token."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from uniforce_vtla.errors import ContractError, expected


class StateToken(nn.Module):
    """The continuous normalised state as one prefix token: text bins are too coarse to learn from few demos.

    While training, noise keeps a policy from reading off the pose what it shall feel: where the board begins.

    Args:
        state_size: axes.
        width: of a token.
        noise: standard deviation per axis, training only; empty adds none.
        moves: axes of the last move, behind the state; 0 = not told.
        move_noise: standard deviation on each of these, training only.

    Raises:
        ContractError: noise for another number of axes.
    """

    def __init__(
        self,
        state_size: int,
        width: int,
        noise: Sequence[float] = (),
        moves: int = 0,
        move_noise: float = 0.0,
    ) -> None:
        super().__init__()
        if noise and len(noise) != state_size:
            do = "Give a number per axis of the state, or none."
            raise ContractError(expected("state_noise", f"{state_size} numbers", list(noise), do))
        self.noise = (
            (*noise, *[move_noise] * moves) if noise else (*[0.0] * state_size, *[move_noise] * moves)
        )
        self.proj = nn.Sequential(nn.Linear(state_size + moves, width), nn.GELU(), nn.Linear(width, width))

    def forward(self, state: Tensor) -> Tensor:
        """Map (B, 1, state_size + moves) to (B, 1, D) of unit RMS."""
        if self.training and any(self.noise):
            state = state + torch.randn_like(state) * state.new_tensor(self.noise)
        hidden = self.proj(state)
        return nn.functional.rms_norm(hidden, hidden.shape[-1:])
