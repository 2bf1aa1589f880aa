"""Rules of the guards, written a second time. Axes: x, y, z, width m, yaw rad; base frame."""

import math
from typing import Any

import numpy as np

SLACK = 1e-5  # m or rad; a rounding is no violation
HERE_m = 1e-3  # as near to the arm as this a target pulls at nothing
HERE_rad = 1e-2


# low, high, step_m, step_rad, speed_m_s, speed_rad_s, speed_width_m_s, longest_gap_s
Limits = Any


def pose_of(axes: np.ndarray) -> np.ndarray:
    """(4, 4) of a hand that points down and closes along the base's x axis at yaw 0."""
    c = np.cos(axes[3])
    s = np.sin(axes[3])
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
    """Return what is wrong with a pose (4,) for an arm that is ``here`` and was sent ``last``."""
    if not np.isfinite(pose).all():
        return ["finite"]
    before = here if last is None else last
    gap_s = limits.longest_gap_s
    allowed_s = _allowed_s(limits, last, elapsed_s)
    corners = np.array([before, here])
    lowest = np.minimum(corners.min(0), limits.low[:4]) - slack
    highest = np.maximum(corners.max(0), limits.high[:4]) + slack
    at_arm = _within(pose, here, HERE_m, HERE_rad, slack)
    wrong = []
    if not ((lowest <= pose) & (pose <= highest)).all():
        wrong.append("box")
    reach = limits.speed_m_s * allowed_s, limits.speed_rad_s * allowed_s
    if not at_arm and not _within(pose, before, *reach, slack):
        wrong.append("rate")
    far_m = limits.step_m + limits.speed_m_s * gap_s
    far_rad = limits.step_rad + limits.speed_rad_s * gap_s
    if not _within(pose, here, far_m, far_rad, slack):
        wrong.append("near")
    return wrong


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
    allowed_s = _allowed_s(limits, last, elapsed_s)
    lowest = np.minimum(before, limits.low) - SLACK
    highest = np.maximum(before, limits.high) + SLACK
    wrong = []
    if not ((lowest <= sent) & (sent <= highest)).all():
        wrong.append("action box")
    reach = limits.speed_m_s * allowed_s, limits.speed_rad_s * allowed_s
    closes_m = abs(sent[4] - before[4])
    too_fast = closes_m > limits.speed_width_m_s * allowed_s + SLACK
    if too_fast or not _within(sent, before, *reach):
        wrong.append("action rate")
    step_m = max(limits.step_m, _gap(before, measured))
    step_rad = max(limits.step_rad, _turn(before, measured))
    is_inside = ((np.array(limits.low) <= measured) & (measured <= limits.high)).all()
    if is_inside and not _within(sent, measured, step_m, step_rad):
        wrong.append("action step")
    return wrong


def _allowed_s(limits: Limits, last: np.ndarray | None, elapsed_s: float) -> float:
    """Return the time for which motion is allowed since what was sent before."""
    if last is None:
        return float(limits.longest_gap_s)
    return min(max(elapsed_s, 0.0), limits.longest_gap_s)


def _within(a: np.ndarray, b: np.ndarray, m: float, rad: float, slack: float = SLACK) -> bool:
    return _gap(a, b) <= m + slack and _turn(a, b) <= rad + slack


def _gap(a: np.ndarray, b: np.ndarray) -> float:
    return math.dist(a[:3], b[:3])


def _turn(a: np.ndarray, b: np.ndarray) -> float:
    return abs(float((b[3] - a[3] + np.pi) % (2 * np.pi) - np.pi))
