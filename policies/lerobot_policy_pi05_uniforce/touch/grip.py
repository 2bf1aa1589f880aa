"""A grip that a finger can't read: as it is read until the hand has lifted, then as demonstrations read it.

A flat gel that a tool covers shows shear but hardly grip. A policy learnt both together: one that reads too little grip
squeezes harder and presses harder than it was shown. A hand that holds a tool keeps its grip, so a stored one serves.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import AXES

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
    from uniforce_vtla.contracts import Finger
    from uniforce_vtla.tokenizer.calibration import Calibration

logger = logging.getLogger(__name__)
HEIGHT = AXES.index("z.pos")
TOUCHES_N = 1.0  # of grip, from which on something is between the fingers
# above the lowest height at which it was touched: it is in the hand, not on the table
LIFT_m = 0.02
FZ = 2  # of a reading's fx, fy, fz


class Lift:
    """Tell when what is touched was lifted; a row for each environment."""

    def __init__(self) -> None:
        self._lowest_m: Tensor | None = None
        self._is_lifted = torch.zeros(0, dtype=torch.bool)

    def see(self, height_m: Tensor, grip_N: Tensor) -> Tensor:
        """Return (B,) bool: touched now and lifted since the start; for the (B,) height of the hand and grip read."""
        if self._lowest_m is None or len(self._lowest_m) != len(height_m):
            self._lowest_m = torch.full_like(height_m, torch.inf)
            self._is_lifted = torch.zeros_like(height_m, dtype=torch.bool)
        touches = grip_N > TOUCHES_N
        lowest_m = torch.minimum(self._lowest_m, height_m)
        self._lowest_m = torch.where(touches, lowest_m, torch.full_like(height_m, torch.inf))
        self._is_lifted = self._is_lifted | (touches & (height_m > self._lowest_m + LIFT_m))
        return self._is_lifted & touches


class GripHold:
    """Replace the grip of some slots once lifted.

    Args:
        held_N: slot → what it gives from then on; a slot that isn't there gives what is read.
    """

    def __init__(self, held_N: Mapping[str, float]) -> None:
        self.held_N = dict(held_N)
        self.reset()

    def reset(self) -> None:
        """Start an episode."""
        self._lifts = {slot: Lift() for slot in self.held_N}

    def __call__(self, slot: str, force_N: Tensor, state: Tensor) -> Tensor:
        """Return a slot's (B, 1, 3) newtons for what is read and the measured state (B, axes)."""
        grip_N = force_N[:, 0, FZ]  # (B,)
        lifted = self._lifts[slot].see(state[:, HEIGHT].to(grip_N), grip_N)
        held = force_N.clone()
        held[:, 0, FZ] = torch.where(lifted, torch.full_like(grip_N, self.held_N[slot]), grip_N)
        return held


def held_grips(
    config: PI05UniforceConfig, worn: Mapping[Finger, Calibration]
) -> tuple[dict[str, float], list[str]]:
    """Return slot → grip to hold in N, and a sentence about each; by ``config.grip``, or as calibrations say.

    Raises ContractError: it is to be held, and the checkpoint doesn't know what demonstrations read.
    """
    found: dict[str, float] = {}
    notes: list[str] = []
    for slot, finger in config.finger_by_slot().items():
        calibration = worn.get(finger)
        can_read = calibration is None or calibration.reads_grip
        if config.grip == "read" or (config.grip == "" and can_read):
            continue
        carried_N = config.touch.carried_N.get(slot)
        if carried_N is None and config.grip == "held":
            do = "Train it again from a view of this version, or leave grip as read."
            raise ContractError(
                expected(f"grip of {slot} to hold", "one in touch.carried_N", "none", do)
            )
        if carried_N is None:
            logger.warning(
                "%s finger: grip can't be read and the checkpoint has none to hold; taken as read",
                finger,
            )
            continue
        found[slot] = carried_N
        why = (
            "as asked"
            if config.grip == "held" or calibration is None
            else calibration.grip_in_words
        )
        notes.append(
            f"{finger} finger: shear felt, grip held at {carried_N:.1f} N once lifted ({why})"
        )
        logger.warning("%s", notes[-1])
    return found, notes


def carried_grip(episodes: Iterable[tuple[Tensor, Tensor]]) -> float | None:
    """Return the median grip over demonstrations while something is lifted, N; None where nothing ever is.

    Each episode is the measured state (T, axes) and what the finger read, (T, 3) N.
    """
    grips: list[Tensor] = []
    for state, force_N in episodes:
        lift = Lift()
        pairs = zip(state[:, HEIGHT].split(1), force_N[:, FZ].split(1), strict=True)
        lifted = [lift.see(height_m, grip_N) for height_m, grip_N in pairs]
        grips.append(force_N[:, FZ][torch.cat(lifted)])
    every = torch.cat(grips) if grips else torch.zeros(0)
    return float(every.median()) if len(every) else None
