"""Actions: the network's predictions, how they become a robot's targets, and what stops a policy.

``target_delta``: step k of a chunk is the change of the commanded target since the last *issued*
command. With a hidden board height and stiffness, force control is an increment on the last
command. A change relative to the *measured* pose would be a force command by itself: impedance
turns commanded − measured into newtons, so a blind policy could hold a press without touch. The
network must not see the last command, because commanded − measured predicts the press. So the base
is added outside the network.

Targets that follow targets run away from an arm that is held back, and it would go there once free.
So each one issued stays within a leash of the measured pose. With the arm's springs that bounds the
force of a blocked policy, stiffness × min(leash, clip) per axis. By default that is
18 mm × 2,000 N/m = 36 N in x and y, and 18 mm × 800 N/m = 14.4 N in z.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import torch
from lerobot.processor import PolicyActionProcessorStep, ProcessorStepRegistry
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import ActionSettings
from uniforce_vtla.errors import ContractError, RolloutError, expected
from uniforce_vtla.keys import AXES

YAW = AXES.index("yaw.pos")
# of the leash per step since the pose was measured: 8 mm, the robot's 0.25 m/s
STRIDE = 0.4
MARGIN = 0.5  # around the demos, of an axis' span
LEAST_ROOM = 0.05  # m or rad: the margin where an axis hardly moved
# of ``delta_scale`` in one control step: 40 mm in x, 0.5 rad; demos stay below 2
LARGEST_LEAP = 10.0


class NetworkUnits(nn.Module):
    """SI units ↔ network units per axis: linear, or by logarithm (asinh) beyond a knee.

    A newton of grip is a tenth of a millimetre of command where closing the hand is forty: squared
    errors of plain moves hardly see forces. And a move grows along the chunk: late steps, which are
    never executed, would weigh hundreds of times as much as the first. So a unit grows with the
    step, as at a steady speed.

    Args:
        scale: (A,) size of one network unit in the middle of a chunk, SI.
        knee: (A,) where the logarithm begins, and the unit there, SI; 0 = linear; () = all linear.
        chunk: steps of a chunk.
    """

    def __init__(self, scale: Sequence[float], knee: Sequence[float] = (), chunk: int = 1) -> None:
        super().__init__()
        knees = torch.tensor(list(knee) or [0.0] * len(scale))
        growth = (torch.arange(chunk)[:, None] + 1) / max(chunk / 2, 1)  # (chunk, 1)
        unit = torch.where(knees > 0, knees, torch.tensor(scale)) * growth  # (chunk, A)
        self.register_buffer("bent", knees > 0, persistent=False)
        self.register_buffer("unit", unit, persistent=False)

    def to_network(self, moves: Tensor) -> Tensor:
        """Turn (…, chunk, A) moves in SI units into network units."""
        units = moves / self.unit
        return torch.where(self.bent, units.asinh(), units)

    def to_si(self, units: Tensor) -> Tensor:
        """Invert :meth:`to_network`."""
        return torch.where(self.bent, units.sinh(), units) * self.unit


def to_deltas(
    actions: Tensor, is_pad: Tensor | None, measured: Tensor, units: NetworkUnits
) -> Tensor:
    """Return (B, chunk, A) changes since the last command, in network units.

    Args:
        actions: (B, 1 + chunk, A) absolute targets in SI units; the first is the last command.
        is_pad: (B, 1 + chunk) bool, or None; a padded first column means the episode starts here.
        measured: (B, A) measured state, the base where no command has been issued yet.
        units: of the network.
    """
    base = actions[:, 0]
    if is_pad is not None:
        base = torch.where(is_pad[:, :1], measured, base)
    return units.to_network(actions[:, 1:] - base[:, None])


def to_targets(deltas: Tensor, base: Tensor, units: NetworkUnits) -> Tensor:
    """Invert :func:`to_deltas`: (B, chunk, A) network units on a (B, A) base → targets, SI."""
    return base[:, None] + units.to_si(deltas)


class IssuedTarget:
    """The last target sent to each environment row."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget it."""
        self.last: Tensor | None = None  # (B, A)
        # (B, A) of the network, before the leash; a chunk's steps follow each other
        self.asked: Tensor | None = None

    def record(self, target: Tensor) -> None:
        """Remember (B, A) targets just handed out."""
        self.last = target.detach().clone()

    def base(self, measured: Tensor) -> Tensor:
        """Return the (B, A) base of the next chunk: what was issued last, else the measured state.

        Raises RolloutError: the number of environments changed without a reset.
        """
        if self.last is None:
            return measured
        if self.last.shape != measured.shape:
            wanted = tuple(self.last.shape)
            came = tuple(measured.shape)
            raise RolloutError(expected("batch", wanted, came, "Call policy.reset() first."))
        return self.last


def check_axes(state_size: int, action_size: int, settings: ActionSettings) -> None:
    """Raise ContractError unless state, action and ``settings`` describe the same axes."""
    bounds = settings.target_range
    axes = len(settings.delta_scale)
    if bounds:
        fits = len(bounds) == 2 and len(bounds[0]) == len(bounds[1]) == axes
        if not fits or not all(low <= high for low, high in zip(*bounds, strict=True)):
            do = "Two lists, [[lowest per axis], [highest per axis]], or [] for none."
            raise ContractError(expected("target_range", "lowest and highest targets", bounds, do))
    knee = settings.delta_knee
    is_delta = settings.form == "target_delta"
    if is_delta and not state_size == action_size == axes:
        came = f"{state_size}, {action_size} and {axes}"
        do = "Or use action.form=absolute."
        raise ContractError(expected("state, action and delta_scale", "equal lengths", came, do))
    if knee and (len(knee) != axes or min(knee) < 0):
        do = "Give one per axis, 0 where moves stay linear, or [] for none."
        raise ContractError(expected("delta_knee", f"{axes} numbers from 0 on", knee, do))
    leash = settings.leash
    if is_delta and (len(leash) != axes or min(leash) <= 0 or not math.isfinite(sum(leash))):
        do = "Give one per axis: how far a target may lead the measured pose."
        raise ContractError(expected("leash", f"{axes} numbers above 0", leash, do))


def check_leap(target: Tensor, last: Tensor | None, scale: Tensor) -> None:
    """Raise RolloutError where a (B, A) target is too far from the last; the first passes."""
    if last is None or last.shape != target.shape:
        return
    leap = (target - last).abs().amax(dim=0)  # (A,)
    times = leap / scale
    if (times > LARGEST_LEAP).any():
        axis = int(times.argmax())
        name = f"change of target, axis {axis}"
        wanted = f"at most {LARGEST_LEAP * float(scale[axis]):.3f} a step"
        raise RolloutError(expected(name, wanted, f"{float(leap[axis]):.3f}", "Hold the robot."))


def on_leash(target: Tensor, measured: Tensor, leash: Tensor, steps: int = 0) -> Tensor:
    """Return (B, A) targets within the leash of the measured pose; those within stay bit-equal.

    Args:
        target: (B, A) that would be issued.
        measured: (B, A) pose.
        leash: (A,) largest lead of each axis.
        steps: control steps since the pose was measured; a free arm has moved on meanwhile.
    """
    lead = target - measured
    if target.shape[-1] == len(AXES):  # the shorter way round
        lead[:, YAW] = torch.remainder(lead[:, YAW] + math.pi, 2 * math.pi) - math.pi
    longest = leash * (1 + STRIDE * steps)
    return torch.where(lead.abs() > longest, measured + lead.clamp(-longest, longest), target)


def stops_outside(where: str) -> bool:
    """Return whether an action outside the demos stops; on a robot LeRobot's rollout runs."""
    return where == "always" or (where == "robot" and "lerobot.rollout" in sys.modules)


def check_within(
    action: Tensor,
    low: Tensor,
    high: Tensor,
    margin: float = MARGIN,
    least_room: float = LEAST_ROOM,
) -> None:
    """Raise RolloutError where an action (…, A) leaves (A,) ``low`` … ``high`` and the margin."""
    room = (margin * (high - low)).clamp_min(least_room)
    low = low - room
    high = high + room
    actions = action.flatten(0, -2)  # (n, A)
    outside = ((actions < low) | (actions > high)).any(dim=0)
    if outside.any():
        axis = int(outside.nonzero()[0])
        came = actions[:, axis].tolist()
        wanted = f"within {float(low[axis]):.3f} … {float(high[axis]):.3f}"
        do = (
            "Hold the robot; nothing like it was ever demonstrated. "
            "Start where the demonstrations did."
        )
        raise RolloutError(expected(f"action, axis {axis}", wanted, came, do))


CHECK_ACTION = "uniforce_check_action"


@ProcessorStepRegistry.register(name=CHECK_ACTION)
@dataclass
class CheckActionStep(PolicyActionProcessorStep):
    """Let an action pass that is finite and within the demos' range, widened on each side.

    The last step of the postprocessor, so that it holds wherever LeRobot runs the policy. A robot's
    own guards come after it and clamp; this one stops.
    """

    # per axis, as the robot takes it; []: only finite is asked
    low: list[float] = field(default_factory=list)
    high: list[float] = field(default_factory=list)
    margin: float = MARGIN  # of the span
    least_room: float = LEAST_ROOM  # m or rad on each side of an axis that the demos hardly moved
    where: str = "always"  # as ``ActionSettings.stop_outside_demos``

    def get_config(self) -> dict[str, Any]:
        """Return what is saved with the policy."""
        return asdict(self)

    def action(self, action: Tensor) -> Tensor:
        """Return the action (…, A) unchanged.

        Raises RolloutError: NaN, inf, or an axis outside the range: hold the robot.
        """
        if not action.isfinite().all():
            do = "Hold the robot; the policy or its input is broken."
            raise RolloutError(expected("action", "finite numbers", "NaN or inf", do))
        if not self.low or not stops_outside(self.where):
            return action
        low = torch.tensor(self.low, dtype=action.dtype)
        high = torch.tensor(self.high, dtype=action.dtype)
        check_within(action.cpu(), low, high, self.margin, self.least_room)
        return action

    def transform_features(self, features: Any) -> Any:
        """Leave the feature description alone."""
        return features
