"""One recorded rollout as its fingers felt it: press, grip and how much of the friction was used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uniforce_vtla.evaluation.episode import ScoreLimits
from uniforce_vtla.evaluation.finger_estimates import FingerEstimate, FingerSettings
from uniforce_vtla.figure_file import save_figure


def draw_estimate(
    found: FingerEstimate, time_s: np.ndarray, truth: FingerEstimate | None, path: Path
) -> Path:
    """Draw an episode's estimates over time, beside the same from true forces where there are any."""
    limits, settings = ScoreLimits(), FingerSettings()
    figure = Figure(figsize=(9, 6), layout="constrained")
    press, grip, friction = figure.subplots(3, 1, sharex=True)
    for estimate, style, label in ((truth, "k:", "from true forces"), (found, "-", "estimate")):
        if estimate is None:
            continue
        press.plot(time_s, estimate.press_N, style, label=label)
        grip.plot(time_s, estimate.grip_N[:, 0], style, label=f"left, {label}")
        grip.plot(time_s, estimate.grip_N[:, 1], style, label=f"right, {label}")
        friction.plot(time_s, estimate.friction_used.min(axis=1), style, label=label)
    press.axhline(limits.mean_press_N, color="C3", lw=0.8, ls="--")
    friction.axhline(settings.friction_share, color="C3", lw=0.8, ls="--")
    press.set_ylabel("press on board [N]")
    grip.set_ylabel("grip [N]")
    friction.set(ylabel="friction used, lesser pad", xlabel="time [s]")
    for panel in (press, grip, friction):
        panel.grid(alpha=0.25)
        panel.legend(fontsize=8, loc="upper left")
    events = [*found.lost, *found.slippage, *found.excess_force]
    figure.suptitle("; ".join(events) if events else "no event")
    return save_figure(figure, path)
