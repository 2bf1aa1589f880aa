"""Slippage and excess force of a real rollout, from what the two fingers measured.

Estimates, not truth.

The simulator knows the press and the slip; a robot has forces read from marker images. Press: what
the pads carry less than in free air, the board carries. Slippage: both pads at their friction limit
at once, for long; in simulation that separates a slide from a firm stroke (docs/benchmark.md).
These forces don't say how far something slid or how deep a pad was pressed.
"""

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.evaluation.episode import ScoreLimits, band_share, longest_run_s, press_events

FY, FZ = 1, 2  # canonical frame: y down along the pad, z into it

HELD_N = 1.5  # grip of each finger above which something is in the hand
LIFT_m = 0.02  # tool height gained since the grasp that counts as lifted
CARRY_s = 0.4  # of free air after the lift, before the board is near: what the eraser weighs
FRICTION_SHARE = 0.9  # of a pad's friction: at its limit, within what heads can read
SLIDE_s = 1.0  # both pads there for so long have let the object slide some millimetres
SMALLEST_GRIP_N = 0.5  # below it shear over grip means nothing


@dataclass(frozen=True)
class FingerEstimate:
    """One episode as the fingers measured it."""

    press_N: np.ndarray  # (n,) on the board; 0 before the lift
    grip_N: np.ndarray  # (n, 2) left, right
    # (n, 2) shear over what the pad's friction allows at this grip; 0 before the lift
    friction_used: np.ndarray
    slippage: tuple[str, ...]  # reasons for a slippage event, empty if none
    # reasons for an excess-force event, empty if none. Pad depth isn't judged.
    excess_force: tuple[str, ...]
    lost: tuple[str, ...]  # reasons to believe the object was dropped or never lifted
    # of the way that the hand moved while pressing, within the limits' band
    in_band_share: float = 0.0

    @property
    def events(self) -> list[str]:
        """All reasons, or "no event"."""
        return [*self.lost, *self.slippage, *self.excess_force] or ["no event"]


def estimate_events(
    time_s: np.ndarray, force_N: np.ndarray, tool_m: np.ndarray, pad_friction: tuple[float, float]
) -> FingerEstimate:
    """Judge one episode from the fingers' forces and the robot's own pose.

    Args:
        time_s: (n,) seconds, rising.
        force_N: (n, 2, 3) left and right, fx, fy, fz in the canonical frame.
        tool_m: (n, 3) measured x, y, z of the tool, robot base frame.
        pad_friction: left, right; from a slow pull until the object slides.

    Raises ContractError: shapes that don't fit, numbers that aren't finite, friction that isn't
    positive; DatasetError: nothing was lifted for long enough to weigh it.
    """
    limits = ScoreLimits()
    _check(time_s, force_N, tool_m, pad_friction)
    grip = force_N[:, :, FZ]
    start = lift_frame(grip, tool_m[:, 2])
    if start is None:
        nothing = np.zeros(len(time_s))
        return FingerEstimate(nothing, grip, np.zeros_like(grip), (), (), ("never lifted",))
    lifted = np.arange(len(time_s)) >= start
    weight_N = force_N[:, :, FY].sum(axis=1)  # (n,) what hangs on both pads
    press = np.where(lifted, np.median(weight_N[_carry(time_s, start)]) - weight_N, 0.0)
    shear = np.linalg.norm(force_N[:, :, :FZ], axis=2)  # (n, 2)
    used = shear / np.maximum(grip, SMALLEST_GRIP_N) / np.asarray(pad_friction)
    used[~lifted] = 0.0
    sliding_s = longest_run_s((used > FRICTION_SHARE).all(axis=1), time_s)
    slid = (f"both pads at their friction limit for {sliding_s:.1f} s",)
    loose = lifted & (grip < limits.lost_grip_N + SMALLEST_GRIP_N).all(axis=1)
    dropped = longest_run_s(loose, time_s) > limits.lost_grip_s
    moved_mm = 1000 * np.linalg.norm(np.diff(tool_m[:, :2], axis=0, prepend=tool_m[:1, :2]), axis=1)
    return FingerEstimate(
        press,
        grip,
        used,
        slid if sliding_s > SLIDE_s else (),
        tuple(press_events(press, time_s, limits)),
        (f"no grip for {limits.lost_grip_s:g} s",) if dropped else (),
        band_share(press, moved_mm, limits),
    )


def lift_frame(grip_N: np.ndarray, tool_z_m: np.ndarray) -> int | None:
    """Return the first frame with something held ``LIFT_m`` above where it was grasped.

    None if there is none.
    """
    held = (grip_N > HELD_N).all(axis=1)
    if not held.any():
        return None
    grasp_z = tool_z_m[int(held.argmax())]
    lifted = held & (tool_z_m > grasp_z + LIFT_m)
    return int(lifted.argmax()) if lifted.any() else None


def _carry(time_s: np.ndarray, start: int) -> slice:
    end_s = time_s[start] + CARRY_s
    if time_s[-1] < end_s:
        came = f"{time_s[-1] - time_s[start]:.2f} s"
        do = "Let the robot carry it through free air first."
        raise DatasetError(expected("time after the lift", f"≥ {CARRY_s:g} s", came, do))
    return slice(start, int(np.searchsorted(time_s, end_s)))


def _check(
    time_s: np.ndarray, force_N: np.ndarray, tool_m: np.ndarray, pad_friction: tuple[float, float]
) -> None:
    n = len(time_s)
    if n < 2 or force_N.shape != (n, 2, 3) or tool_m.shape != (n, 3):
        came = f"{time_s.shape}, {force_N.shape}, {tool_m.shape}"
        raise ContractError(
            expected("time, forces, place", "(n,), (n, 2, 3), (n, 3), n ≥ 2", came, "Align them.")
        )
    if not all(np.isfinite(values).all() for values in (time_s, force_N, tool_m)):
        do = "Check the sensors of this episode."
        raise ContractError(expected("time, forces, place", "finite numbers", "NaN or inf", do))
    if (np.diff(time_s) <= 0).any():
        raise ContractError(expected("time_s", "rising", "frames out of order", "Sort them."))
    if not all(mu > 0 for mu in pad_friction):
        do = "Measure it: pull slowly until the object slides, shear over grip."
        raise ContractError(expected("pad_friction", "two numbers above 0", pad_friction, do))
