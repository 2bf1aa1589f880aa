"""Rules of the guards, written a second time. Axes: x, y, z m, yaw rad, of an action width m; base frame."""

import math
from typing import Any

import numpy as np

SLACK = 1e-5  # m or rad; a rounding is no violation
HERE_m, HERE_rad = 1e-3, 1e-2  # as near to the arm as this a target pulls at nothing


Limits = Any  # low, high, step_m, step_rad, speed_m_s, speed_rad_s, speed_width_m_s, longest_gap_s


def pose_of(axes: np.ndarray) -> np.ndarray:
    """(4, 4) of a hand that points down and closes along the base's x axis at yaw 0."""
    c, s = np.cos(axes[3]), np.sin(axes[3])
    return np.array([[-s, c, 0, axes[0]], [c, s, 0, axes[1]], [0, 0, -1, axes[2]], [0, 0, 0, 1.0]])


def axes_of(pose: np.ndarray) -> np.ndarray:
    """(4,) of a (4, 4) pose; NaN where the hand does not point straight down."""
    axes = np.array([*pose[:3, 3], np.arctan2(pose[1, 1], pose[0, 1])])
    return axes if np.abs(pose - pose_of(axes)).max() < 1e-6 else np.full(4, np.nan)


def wrong_pose(
    limits: Limits,
    pose: np.ndarray,
    here: np.ndarray,
    last: np.ndarray | None,
    elapsed_s: float,
    slack: float = SLACK,
) -> list[str]:
    """Return what is wrong with a pose (4,) on its way to an arm that is ``here`` and was sent ``last`` before."""
    if not np.isfinite(pose).all():
        return ["finite"]
    before = here if last is None else last
    gap_s = limits.longest_gap_s
    allowed_s = gap_s if last is None else min(max(elapsed_s, 0.0), gap_s)
    corners = np.array([before, here])
    lowest = np.minimum(corners.min(0), limits.low[:4]) - slack
    highest = np.maximum(corners.max(0), limits.high[:4]) + slack
    at_arm = _gap(pose, here) <= HERE_m + slack and _turn(pose, here) <= HERE_rad + slack
    slow = _gap(pose, before) <= limits.speed_m_s * allowed_s + slack
    slow &= _turn(pose, before) <= limits.speed_rad_s * allowed_s + slack
    near = _gap(pose, here) <= limits.step_m + limits.speed_m_s * gap_s + slack
    near &= _turn(pose, here) <= limits.step_rad + limits.speed_rad_s * gap_s + slack
    rules = {
        "box": ((lowest <= pose) & (pose <= highest)).all(),
        "rate": slow or at_arm,
        "near": near,
    }
    return [name for name, holds in rules.items() if not holds]


def wrong_action(
    limits: Limits,
    sent: np.ndarray,
    measured: np.ndarray,
    last: np.ndarray | None,
    elapsed_s: float,
) -> list[str]:
    """Return what is wrong with an action (5,) after the guards, ``last`` being the one before."""
    if not np.isfinite(sent).all():
        return ["finite"]
    before = measured if last is None else last
    allowed_s = (
        limits.longest_gap_s if last is None else min(max(elapsed_s, 0.0), limits.longest_gap_s)
    )
    lowest, highest = (
        np.minimum(before, limits.low) - SLACK,
        np.maximum(before, limits.high) + SLACK,
    )
    inside = ((np.array(limits.low) <= measured) & (measured <= limits.high)).all()
    rules = {
        "box": ((lowest <= sent) & (sent <= highest)).all(),
        "rate": _gap(sent, before) <= limits.speed_m_s * allowed_s + SLACK
        and _turn(sent, before) <= limits.speed_rad_s * allowed_s + SLACK
        and abs(sent[4] - before[4]) <= limits.speed_width_m_s * allowed_s + SLACK,
        "step": not inside
        or (
            _gap(sent, measured) <= max(limits.step_m, _gap(before, measured)) + SLACK
            and _turn(sent, measured) <= max(limits.step_rad, _turn(before, measured)) + SLACK
        ),
    }
    return [f"action {name}" for name, holds in rules.items() if not holds]


def _gap(a: np.ndarray, b: np.ndarray) -> float:
    return math.dist(a[:3], b[:3])


def _turn(a: np.ndarray, b: np.ndarray) -> float:
    return abs(float((b[3] - a[3] + np.pi) % (2 * np.pi) - np.pi))
