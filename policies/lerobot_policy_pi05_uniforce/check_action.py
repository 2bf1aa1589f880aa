"""Stop a policy whose action can't be meant: not finite, far outside what its demos commanded, or a leap.

The range check is the last step of the postprocessor, so that it holds wherever LeRobot runs the policy; it is asked
for with ``policy.stop_outside_demos=true``, without which that step asks for finite numbers alone. The leap is checked
where the last command is known. A robot's own guards come after both and clamp; these stop.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from lerobot.processor import PolicyActionProcessorStep, ProcessorStepRegistry
from torch import Tensor

from uniforce_vtla.errors import RolloutError, expected
from uniforce_vtla.keys import ACTION

LARGEST_LEAP = 10.0  # of ``delta_scale`` in one control step: 40 mm in x, 0.5 rad; demos stay below 2


@ProcessorStepRegistry.register(name="uniforce_check_action")
@dataclass
class CheckActionStep(PolicyActionProcessorStep):
    """Let an action pass that is finite and within the demos' range, widened by ``margin`` of its span on each side.

    Attributes:
        low, high: per axis, in the units the robot takes; empty where no statistics were given: only finite is asked.
        margin: of the span.
    """

    low: list[float] = field(default_factory=list)
    high: list[float] = field(default_factory=list)
    margin: float = 0.5
    least_room: float = 0.05  # m or rad on each side of an axis that the demos hardly moved

    @classmethod
    def of(cls, stats: dict[str, dict[str, Any]] | None) -> CheckActionStep:
        """Return the step for these training statistics."""
        action = (stats or {}).get(ACTION, {})
        if "min" not in action or "max" not in action:
            return cls()
        return cls(*(torch.as_tensor(action[bound]).flatten().tolist() for bound in ("min", "max")))

    def get_config(self) -> dict[str, Any]:
        """Return what is saved with the policy."""
        return {"low": self.low, "high": self.high, "margin": self.margin, "least_room": self.least_room}

    def action(self, action: Tensor) -> Tensor:
        """Return the action (…, A) unchanged.

        Raises:
            RolloutError: NaN, inf, or an axis outside the range: hold the robot.
        """
        if not bool(action.isfinite().all()):
            do = "Hold the robot; the policy or its input is broken."
            raise RolloutError(expected("action", "finite numbers", "NaN or inf", do))
        if self.low:
            self._in_range(action)
        return action

    def _in_range(self, action: Tensor) -> None:
        low, high = (torch.tensor(bound, dtype=action.dtype) for bound in (self.low, self.high))
        room = (self.margin * (high - low)).clamp_min(self.least_room)
        outside = ((action.cpu() < low - room) | (action.cpu() > high + room)).flatten(0, -2).any(dim=0)
        if bool(outside.any()):
            axis = int(outside.nonzero()[0])
            came = action.flatten(0, -2)[:, axis].tolist()
            wanted = f"within {float((low - room)[axis]):.3f} … {float((high + room)[axis]):.3f}"
            do = "Hold the robot; nothing like it was ever demonstrated."
            raise RolloutError(expected(f"action, axis {axis}", wanted, came, do))

    def transform_features(self, features: Any) -> Any:
        """Leave the feature description alone."""
        return features


def check_leap(target: Tensor, last: Tensor | None, scale: Tensor) -> None:
    """Raise RolloutError where a (B, A) target lies too far from the one before it; the first one always passes."""
    if last is None or last.shape != target.shape:
        return
    leap = ((target - last).abs() / scale).max(dim=0).values  # (A,)
    if bool((leap > LARGEST_LEAP).any()):
        axis = int(leap.argmax())
        wanted = f"at most {LARGEST_LEAP * float(scale[axis]):.3f} a step"
        came = f"{float((target - last).abs()[:, axis].max()):.3f}"
        raise RolloutError(expected(f"change of target, axis {axis}", wanted, came, "Hold the robot."))
