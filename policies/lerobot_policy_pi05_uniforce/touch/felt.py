"""State and touch, which stand behind cameras and text."""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Felt:
    """The measured state, and each touch slot in the order of the policy's slots."""

    state: Tensor | None = None  # (B, 1, S); None: the policy takes no state token
    touches: tuple[Tensor, ...] = ()  # (B, K, numbers) each
    masks: tuple[Tensor, ...] = ()  # (B,) bool each, False where a slot is lost or hidden


NOTHING = Felt()
