"""The watched finger's grip beside the other one's, which a policy need not feel with; a warning where they differ."""

import logging
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.finger_balance import EVERY, FingerBalance, imbalance

logger = logging.getLogger(__name__)


class GripComparison:
    """Looks at both fingers every few control steps, and warns once an episode.

    Args:
        encoder: TactileEncoder; nothing is compared where it has no head.
        worn: finger → calibration of its sensor.
        steps: control steps between two looks of the policy.
    """

    def __init__(self, encoder: Any, worn: Mapping[Finger, Calibration], steps: int) -> None:
        self._encoder, self._worn, self._every = encoder, worn, max(1, EVERY // steps)
        self._balance = FingerBalance()
        self.reset()

    def reset(self) -> None:
        """Start an episode."""
        self._balance.reset()
        self._looks = 0

    def look(self) -> bool:
        """Count a look of the policy; return whether it compares."""
        self._looks += 1
        return (
            self._encoder.head is not None
            and self._looks % self._every == 0
            and not self._balance.done
        )

    @torch.no_grad()
    def see(self, slot: str, finger: Finger, own: Tensor, others_pair: list[Tensor]) -> None:
        """Take in a finger's (B, P, L) latents, after its calibration, and the other one's (B, H, W) images."""
        other = next(one for one in FINGERS if one != finger)
        try:
            beside = self._encoder(slot, other, *others_pair)
        except ContractError:  # it shows no markers: the policy does without it
            return
        beside = self._worn[other].map(beside) if other in self._worn else beside
        times = self._balance.see(self._grip_N(finger, own), self._grip_N(other, beside))
        if times is not None and imbalance(times) > 1:
            message = "%s finger reads %.2f times the other one's grip: one of them is wrong in scale, calibrate it"
            logger.warning(message, finger, times)

    def _grip_N(self, finger: Finger, latent: Tensor) -> float:  # noqa: N802  a unit
        force_N = self._encoder.head.step(latent, None)[0]
        read_N = self._worn[finger].scaled(force_N) if finger in self._worn else force_N
        return float(read_N[:, 2].mean())
