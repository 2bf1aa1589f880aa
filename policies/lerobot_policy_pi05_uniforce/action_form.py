"""Action forms: what the network predicts, and how that becomes the absolute targets every robot takes.

``target_delta``: step k of a chunk is the change of the commanded target since the last *issued* command.
Why: with a hidden board height and stiffness, force control is an increment on the last command.  A change
relative to the *measured* pose would be a force command by itself (impedance turns commanded − measured into
newtons), so a blind policy could hold a press without feeling it; and the network must not see the last
command, because commanded − measured predicts the press.  Hence the base is added outside the network.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from uniforce_vtla.errors import ContractError, RolloutError, expected


class NetworkUnits(nn.Module):
    """SI units ↔ what the network predicts, per axis: linear, or by logarithm beyond a knee.

    A newton of grip is a tenth of a millimetre of command where closing the hand is forty: squared errors of plain
    moves hardly see forces. Beyond the knee asinh tells a move by its size's logarithm, so that both weigh.

    Args:
        scale: (A,) size of one network unit, SI.
        knee: (A,) where the logarithm begins and the size of one unit below it, SI; 0 = linear; () = all linear.
    """

    def __init__(self, scale: Sequence[float], knee: Sequence[float] = ()) -> None:
        super().__init__()
        knees = torch.tensor(list(knee) or [0.0] * len(scale))
        self.register_buffer("bent", knees > 0, persistent=False)
        self.register_buffer(
            "unit", torch.where(knees > 0, knees, torch.tensor(list(scale))), persistent=False
        )

    def told(self, moves: Tensor) -> Tensor:
        """Turn (…, A) moves in SI units into network units."""
        units = moves / self.unit
        return torch.where(self.bent, units.asinh(), units)

    def meant(self, units: Tensor) -> Tensor:
        """Invert :meth:`told`."""
        return torch.where(self.bent, units.sinh(), units) * self.unit


def to_deltas(actions: Tensor, is_pad: Tensor | None, measured: Tensor, units: NetworkUnits) -> Tensor:
    """Turn absolute targets into changes since the last command, in network units.

    Args:
        actions: (B, 1 + chunk, A) absolute targets in SI units; the first is the last command issued.
        is_pad: (B, 1 + chunk) bool, or None; a padded first column means the episode starts here.
        measured: (B, A) measured state, the base where no command has been issued yet, as in a rollout.
        units: of the network.

    Returns:
        (B, chunk, A).
    """
    base = actions[:, 0]
    if is_pad is not None:
        base = torch.where(is_pad[:, :1], measured, base)
    return units.told(actions[:, 1:] - base[:, None])


def to_targets(deltas: Tensor, base: Tensor, units: NetworkUnits) -> Tensor:
    """Invert :func:`to_deltas`: (B, chunk, A) network units on a (B, A) base → absolute targets, SI units."""
    return base[:, None] + units.meant(deltas)


class TargetRange(nn.Module):
    """Keeps absolute targets within the demos' own.

    Args:
        axes: A.
        bounds: the lowest and the highest target (A,) each, SI; [] keeps nothing.

    Raises:
        ContractError: bounds that aren't two of that length, the first nowhere above the second.
    """

    def __init__(self, axes: int, bounds: Sequence[Sequence[float]] = ()) -> None:
        super().__init__()
        if bounds and not ([len(bound) for bound in bounds] == [axes, axes] and _rising(*bounds)):
            do = "Two lists, [[lowest per axis], [highest per axis]], or [] for none."
            raise ContractError(expected("target_range", "lowest and highest targets", bounds, do))
        low, high = bounds or ((-math.inf,), (math.inf,))
        self.register_buffer("low", torch.tensor(list(low)), persistent=False)
        self.register_buffer("high", torch.tensor(list(high)), persistent=False)

    def kept(self, targets: Tensor) -> Tensor:
        """Return (…, A) targets, each axis no further than the range goes; NaN stays NaN."""
        return targets.clamp(self.low.to(targets), self.high.to(targets))


def _rising(low: Sequence[float], high: Sequence[float]) -> bool:
    return all(below <= above for below, above in zip(low, high, strict=True))


def told_move(commands: Tensor) -> Tensor:
    """Return (B, A) how far the command moved before a sample, SI: from the first of its (B, T, A) to the second.

    Before an episode's first command both are that command, so nothing moved.
    """
    return commands[:, 1] - commands[:, 0]


class IssuedTarget:
    """The last targets sent to each environment row; empty until the first one after a reset.

    Args:
        steps: how many steps back ``moved`` looks.
    """

    def __init__(self, steps: int = 0) -> None:
        self._targets: deque[Tensor] = deque(maxlen=steps + 1)

    def reset(self) -> None:
        """Forget all targets."""
        self._targets.clear()

    def record(self, target: Tensor) -> None:
        """Remember (B, A) targets just handed out."""
        self._targets.append(target.detach().clone())

    @property
    def last(self) -> Tensor | None:
        """The (B, A) targets sent last, None after a reset."""
        return self._targets[-1] if self._targets else None

    def base(self, measured: Tensor) -> Tensor:
        """Return the (B, A) base of the next chunk: what was issued last, else the measured state.

        Raises:
            RolloutError: the number of environments changed without a reset.
        """
        if self.last is None:
            return measured
        if self.last.shape != measured.shape:
            raise RolloutError(
                expected("batch", tuple(self.last.shape), tuple(measured.shape), "Call policy.reset() first.")
            )
        return self.last

    def moved(self, measured: Tensor) -> Tensor:
        """Return (B, A) how far the target moved over the steps kept, 0 before the second; SI units.

        Raises:
            RolloutError: as ``base``.
        """
        if self.last is None:
            return torch.zeros_like(measured)
        return self.base(measured) - self._targets[0]


def check_axes(state_size: int, action_size: int, scale: list[float], knee: list[float]) -> None:
    """Raise ContractError unless state, action, ``delta_scale`` and any ``delta_knee`` describe the same axes."""
    if knee and (len(knee) != len(scale) or min(knee) < 0):
        do = "Give one per axis, 0 where moves stay linear, or [] for none."
        raise ContractError(expected("delta_knee", f"{len(scale)} numbers from 0 on", knee, do))
    if not state_size == action_size == len(scale):
        came = f"{state_size}, {action_size} and {len(scale)}"
        raise ContractError(
            expected("state, action and delta_scale", "equal lengths", came, "Or use action_form=absolute.")
        )
