"""Compare the grip that two fingers read, and warn once an episode where they differ."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from torch import Tensor

from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.finger_balance import EVERY, FingerBalance, imbalance

if TYPE_CHECKING:
    from uniforce_vtla.force_sensor import ForceSensor

logger = logging.getLogger(__name__)


class GripComparison:
    """Looks at both fingers every few control steps.

    Args:
        own: sensor that the policy feels with; nothing is compared where it reads no newtons.
        other: sensor of the finger beside it.
        steps: control steps between two readings of the policy.
    """

    def __init__(self, own: ForceSensor, other: ForceSensor, steps: int) -> None:
        self.own = own
        self.other = other
        self._every = max(1, EVERY // steps)
        self._balance = FingerBalance()
        self.reset()

    def reset(self) -> None:
        """Start an episode."""
        self._balance.reset()
        self._looks = 0

    def look(self) -> bool:
        """Count a reading of the policy; return whether it compares."""
        self._looks += 1
        is_due = self._looks % self._every == 0
        return self.own.newtons is not None and is_due and not self._balance.done

    def see(self, latent: Tensor, other_pair: tuple[Tensor, Tensor]) -> None:
        """Take in the own finger's calibrated latents (B, K, L) and the other's images (B, H, W)."""
        try:
            beside = self.other.encode(*other_pair)
        except ContractError:  # it shows no markers: the policy does without it
            return
        times = self._balance.see(_grip_N(self.own, latent), _grip_N(self.other, beside))
        if times is not None and imbalance(times) > 1:
            message = (
                "%s finger reads %.2f times the other one's grip: one of them is wrong in scale, "
                "calibrate it"
            )
            logger.warning(message, self.own.finger, times)


def _grip_N(sensor: ForceSensor, latent: Tensor) -> float:  # noqa: N802  a unit
    assert sensor.newtons is not None, "look() has seen that there is a head"
    return float(sensor.newtons(latent)[:, 2].mean())
