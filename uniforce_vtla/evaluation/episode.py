"""Result of one episode: exclusive outcome, overlapping events, continuous numbers.

Everything is computed from a trace of true (on hardware: estimated) quantities, without an
environment. Outcomes sum to n; events may overlap; a clean success is one without an event.
"""

from dataclasses import dataclass, field, fields

import numpy as np

from uniforce_vtla.errors import ContractError, expected


@dataclass(frozen=True)
class ScoreLimits:
    """Where an episode stops being good; printed with every score."""

    residual_share: float = 0.10  # of the initial ink cells
    slip_mm: float = 5.0  # in-hand displacement since the lift
    quick_slip_mm: float = 3.0  # in-hand displacement within quick_slip_s
    quick_slip_s: float = 0.5  # s
    drop_mm: float = 20.0  # in-hand displacement that counts as a drop
    lost_grip_N: float = 0.05  # a pad below this does not hold
    lost_grip_s: float = 0.3  # both pads below it for this long after the lift is a drop
    mean_press_N: float = 10.0  # over mean_press_s
    mean_press_s: float = 0.5  # s
    peak_press_N: float = 15.0  # any frame
    wiping_press_N: float = 0.5  # above this a frame counts as wiping
    band_N: tuple[float, float] = (4.0, 8.0)  # of the press that the task asks for
    in_band_share: float = 0.0  # of the sliding distance that a clean wipe presses within the band


WIPING_PHASE = 2  # of EpisodeTrace.phase


@dataclass(frozen=True)
class EpisodeTrace:
    """Per-step arrays of one episode, all of length n."""

    time_s: np.ndarray  # end of each step
    press_N: np.ndarray  # eraser on board
    grip_left_N: np.ndarray  # normal force on the left pad
    grip_right_N: np.ndarray  # normal force on the right pad
    slip_mm: np.ndarray  # in-hand displacement across the pads since the lift; 0 before it
    depth_left_mm: np.ndarray  # indentation of the left pad
    depth_right_mm: np.ndarray  # indentation of the right pad
    tool_z_mm: np.ndarray  # measured tool height
    slide_mm: np.ndarray  # how far the eraser slid along the board within the step
    residual: np.ndarray  # visible ink over initial ink
    phase: np.ndarray  # 0 before the lift, 1 carrying, 2 wiping, 3 lifted off after wiping
    rated_depth_mm: tuple[float, float]  # (left, right) deepest indentation the sensors allow

    def __post_init__(self) -> None:
        for name in STEP_FIELDS:
            values = getattr(self, name)
            what = f"trace.{name}"
            if values.shape != self.time_s.shape or values.ndim != 1:
                raise ContractError(
                    expected(what, self.time_s.shape, values.shape, "One value per step.")
                )
            if not np.isfinite(values).all():
                raise ContractError(
                    expected(what, "finite numbers", "NaN or inf", "Check the simulation.")
                )


STEP_FIELDS = tuple(f.name for f in fields(EpisodeTrace) if f.name != "rated_depth_mm")


def empty_trace() -> EpisodeTrace:
    """Return the trace of an episode that ended before its first step."""
    steps = {name: np.zeros(0) for name in STEP_FIELDS}
    return EpisodeTrace(**steps, rated_depth_mm=(0.0, 0.0))


@dataclass(frozen=True)
class EpisodeResult:
    """The verdict on one episode.

    ``outcome`` is one of ``keys.OUTCOME_NAMES``; ``reasons`` explains it and each event.
    """

    outcome: str
    slippage: bool
    excess_force: bool
    reasons: tuple[str, ...]
    metrics: dict[str, float] = field(default_factory=dict)
    in_band: bool = True

    @property
    def success(self) -> bool:
        """The wipe itself succeeded, whatever happened on the way."""
        return self.outcome == "success"

    @property
    def clean(self) -> bool:
        """Success without slippage or excess force, pressed within the band."""
        return self.success and not self.slippage and not self.excess_force and self.in_band


def score_episode(trace: EpisodeTrace, limits: ScoreLimits | None = None) -> EpisodeResult:
    """Judge one episode; aborted (no step taken) > failed_grasp > residual > success."""
    limits = limits or ScoreLimits()
    if len(trace.time_s) == 0:
        return EpisodeResult("aborted", False, False, ("no step was taken",))
    slips = slip_events(trace, limits)
    excess = excess_events(trace, limits)
    outcome, why = _outcome(trace, limits)
    metrics = _metrics(trace, limits)
    reasons = (*why, *slips, *excess)
    in_band = metrics["in_band_share"] >= limits.in_band_share
    if not in_band:
        share = f"{limits.in_band_share:.0%}"
        reasons += (f"less than {share} of the sliding pressed within the band",)
    return EpisodeResult(outcome, bool(slips), bool(excess), reasons, metrics, in_band)


def _outcome(trace: EpisodeTrace, limits: ScoreLimits) -> tuple[str, list[str]]:
    if faults := grasp_faults(trace, limits):
        return "failed_grasp", faults
    if trace.residual[-1] > limits.residual_share:
        pressed = (trace.press_N > limits.wiping_press_N).any()
        why = "pressed too lightly or not everywhere" if pressed else "never touched the board"
        return "residual", [why]
    return "success", []


def grasp_faults(trace: EpisodeTrace, limits: ScoreLimits) -> list[str]:
    """Return why the grasp failed; empty if the eraser was held from the lift to the end."""
    lifted = trace.phase >= 1
    if not lifted.any():
        return ["never lifted"]
    loose = (
        lifted
        & (trace.grip_left_N < limits.lost_grip_N)
        & (trace.grip_right_N < limits.lost_grip_N)
    )
    faults = []
    if trace.slip_mm.max() > limits.drop_mm:
        faults.append(f"slid out of the hand (> {limits.drop_mm:g} mm)")
    if longest_run_s(loose, trace.time_s) > limits.lost_grip_s:
        faults.append(f"dropped (no grip for {limits.lost_grip_s:g} s)")
    return faults


def slip_events(trace: EpisodeTrace, limits: ScoreLimits) -> list[str]:
    """Return the reasons for a slippage event."""
    events = []
    if trace.slip_mm.max() > limits.slip_mm:
        events.append(f"slip > {limits.slip_mm:g} mm")
    window = max(1, round(limits.quick_slip_s / _step_s(trace.time_s)))
    moved = trace.slip_mm[window:] - trace.slip_mm[:-window]
    if len(moved) and np.abs(moved).max() > limits.quick_slip_mm:
        events.append(f"slip > {limits.quick_slip_mm:g} mm in {limits.quick_slip_s:g} s")
    return events


def excess_events(trace: EpisodeTrace, limits: ScoreLimits) -> list[str]:
    """Return the reasons for an excess-force event."""
    events = press_events(trace.press_N, trace.time_s, limits)
    left_mm, right_mm = trace.rated_depth_mm
    if trace.depth_left_mm.max() > left_mm:
        events.append(f"left pad deeper than {left_mm:g} mm")
    if trace.depth_right_mm.max() > right_mm:
        events.append(f"right pad deeper than {right_mm:g} mm")
    return events


def press_events(press_N: np.ndarray, time_s: np.ndarray, limits: ScoreLimits) -> list[str]:
    """Return the reasons to call a press (n,) excessive; pads may be too deep for other reasons."""
    events = []
    if running_mean(press_N, limits.mean_press_s, time_s).max() > limits.mean_press_N:
        events.append(f"mean press > {limits.mean_press_N:g} N")
    if press_N.max() > limits.peak_press_N:
        events.append(f"peak press > {limits.peak_press_N:g} N")
    return events


def running_mean(values: np.ndarray, span_s: float, time_s: np.ndarray) -> np.ndarray:
    """Return (n − w + 1,) means over the last ``span_s``; the plain mean of a shorter trace."""
    window = min(max(1, round(span_s / _step_s(time_s))), len(values))
    total = np.concatenate([[0.0], np.cumsum(values, dtype=np.float64)])
    return (total[window:] - total[:-window]) / window


def _step_s(time_s: np.ndarray) -> float:
    if len(time_s) < 2:
        return 1.0
    return float(np.median(np.diff(time_s)))


def longest_run_s(flags: np.ndarray, time_s: np.ndarray) -> float:
    """Return the duration of the longest stretch of True in (n,) flags."""
    frames = np.diff(runs(flags)).max(initial=0)
    return float(frames) * _step_s(time_s)


def runs(flags: np.ndarray) -> np.ndarray:
    """Return (k, 2): first frame of each stretch of True in (n,) flags, and the end of it."""
    return np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]]))).reshape(-1, 2)


def band_share(press_N: np.ndarray, slide_mm: np.ndarray, limits: ScoreLimits) -> float:
    """Return the share of the sliding distance (n,) pressed within the band; 0: nothing slid."""
    slid_mm = np.where(press_N > limits.wiping_press_N, slide_mm, 0.0)
    low, high = limits.band_N
    inside = (press_N >= low) & (press_N <= high)
    return float(slid_mm[inside].sum() / max(slid_mm.sum(), 1e-9))


def _metrics(trace: EpisodeTrace, limits: ScoreLimits) -> dict[str, float]:
    wiping = trace.press_N > limits.wiping_press_N
    press = trace.press_N[wiping]
    height = trace.tool_z_mm[wiping]
    grip = (trace.grip_left_N + trace.grip_right_N) / 2
    wiping_grip = grip[wiping]
    if not wiping.any():
        press = np.zeros(1)
        height = np.zeros(1)
        wiping_grip = grip
    return {
        "residual": float(trace.residual[-1]),
        "press_mean_N": float(press.mean()),
        "press_p95_N": float(np.percentile(press, 95)),
        "in_band_share": band_share(trace.press_N, trace.slide_mm, limits),
        "press_max_N": float(trace.press_N.max()),
        "grip_mean_N": float(wiping_grip.mean()),
        "grip_max_N": float(grip.max()),
        "slip_max_mm": float(trace.slip_mm.max()),
        "depth_left_max_mm": float(trace.depth_left_mm.max()),
        "depth_right_max_mm": float(trace.depth_right_mm.max()),
        "wiping_z_sd_mm": float(height.std()),
        "duration_s": float(trace.time_s[-1]),
    }
