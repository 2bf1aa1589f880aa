"""Which frames of a recorded episode tell the story, and which stretches lie beyond a limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.evaluation.episode import ScoreLimits, runs
from uniforce_vtla.evaluation.finger_estimates import FY, FZ, FingerEstimate, FingerSettings, lift_frame


@dataclass(frozen=True)
class Stretch:
    """Frames ``first`` … ``end − 1`` beyond a limit; whether that makes an event is for the scores to say."""

    name: str
    first: int
    end: int


def telling_moments(force_N: np.ndarray, tool_z_m: np.ndarray) -> dict[str, int]:
    """Return frame by name, in order of time.

    Args:
        force_N: (n, 2, 3) left and right, canonical frame.
        tool_z_m: (n,) measured height.
    """
    settings = FingerSettings()
    grip = force_N[:, :, FZ]
    held = (grip > settings.held_N).all(axis=1)
    lifted = lift_frame(grip, tool_z_m, settings)
    found = {"start": 0, "end": len(force_N) - 1, "strongest grip": int(grip.sum(axis=1).argmax())}
    if held.any():
        found["grasped"] = int(held.argmax())
    if lifted is not None:
        found["lifted"] = lifted
        found["strongest push"] = lifted + int(force_N[lifted:, :, FY].sum(axis=1).argmin())
    return dict(sorted(found.items(), key=lambda item: item[1]))


def stretches(found: FingerEstimate, limits: ScoreLimits, settings: FingerSettings) -> list[Stretch]:
    """Return where the press, or the friction both pads use, is beyond its limit."""
    beyond = {
        f"press > {limits.mean_press_N:g} N": found.press_N > limits.mean_press_N,
        "both pads at their friction limit": found.friction_used.min(axis=1) > settings.friction_share,
    }
    return [
        Stretch(name, int(first), int(end)) for name, flags in beyond.items() for first, end in runs(flags)
    ]
