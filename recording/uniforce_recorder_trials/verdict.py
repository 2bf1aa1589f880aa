"""What was asked beside what was seen; a part not run in full, or on a stretched rig, gets no verdict."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

EPISODES, KILLS, TIMES = 50, 20, 10
HELD_s = {"mute_at_connect": 3.0, "wrong_version": 3.0}  # of these nothing moves: until the error
HELD_IN_s = 0.5  # of all others
OPEN, MET, MISSED = "not judged", "met", "missed"


def bars(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Return each bar with its verdict: ``met``, ``missed`` or ``not judged``."""
    found = [*_end_to_end(result), *_kill9(result), *_faults(result), *_overhead(result)]
    return [
        {"bar": bar, "asked": asked, "seen": seen, "verdict": verdict}
        for part, bar, asked, seen, is_met, is_whole in found
        for verdict in [_verdict(result, part, is_met, is_whole)]
    ]


Found = tuple[str, str, str, object, bool, bool]


def _verdict(result: dict[str, Any], part: str, is_met: bool, is_whole: bool) -> str:
    if not is_whole or not result["runs"][part]["judged"]:
        return OPEN
    return MET if is_met else MISSED


def _end_to_end(result: dict[str, Any]) -> Iterator[Found]:
    seen = result.get("end_to_end")
    if seen is None:
        return
    part, whole = "end_to_end", seen["episodes"] >= EPISODES
    extremes = seen["hz_lowest"], seen["hz_highest"]
    in_beat = all(abs(hz - 30) <= 0.3 for hz in extremes)
    yield (
        part,
        "mean rate of each episode",
        "30.0 ± 0.3 Hz",
        f"{extremes[0]} to {extremes[1]} Hz",
        in_beat,
        whole,
    )
    ratio = seen["jitter_ratio"]
    yield part, "p99 tick jitter over the idle loop's", "≤ 3", ratio, ratio <= 3, whole
    yield part, "frames lost", "0", seen["lost_frames"], not seen["lost_frames"], whole
    loads = seen["loads_in_stock_lerobot"]
    yield part, "loads in stock LeRobot", "yes", loads, loads, whole
    steps = seen["trained_steps"]
    yield part, "steps trained on it", "20", steps, steps >= 20, whole


def _kill9(result: dict[str, Any]) -> Iterator[Found]:
    seen = result.get("kill9")
    if seen is None:
        return
    whole = seen["trials"] >= KILLS
    lost = seen["saved_episodes_lost"]
    yield "kill9", f"saved episodes lost in {seen['trials']} kills", "0", lost, not lost, whole
    resumed = seen["resumed"]
    yield "kill9", "sessions that went on after a kill", "all", resumed, resumed == seen["trials"], whole


def _faults(result: dict[str, Any]) -> Iterator[Found]:
    for name, seen in result.get("faults", {}).items():
        whole = seen["trials"] >= TIMES
        right = seen["right_outcome"]
        outcome = f"{right} of {seen['trials']}"
        yield "faults", f"{name}: right outcome", "all", outcome, right == seen["trials"], whole
        worst_s, within_s = seen["worst_hold_s"], HELD_s.get(name, HELD_IN_s)
        if worst_s is not None:
            yield "faults", f"{name}: held", f"≤ {within_s} s", f"{worst_s} s", worst_s <= within_s, whole


def _overhead(result: dict[str, Any]) -> Iterator[Found]:
    seen = result.get("overhead")
    if seen is None:
        return
    read_ms, cores = seen["observation_read"]["p95_ms"], seen["recorder"]["cores"]
    yield "overhead", "observation read without images, p95", "≤ 3 ms", f"{read_ms} ms", read_ms <= 3, True
    yield "overhead", "recorder, two 640×480 cameras", "≤ 0.6 cores", f"{cores} cores", cores <= 0.6, True
    uskin = seen["uskin"]
    whole = uskin["seconds"] >= 60
    lost = uskin["sent"] - uskin["samples"] + uskin["lost"] + uskin["bad"]
    in_rate = not lost and abs(uskin["rate_hz"] - 500) <= 10
    yield "overhead", "uSkin scans lost at 500/s", "0", f"{lost} at {uskin['rate_hz']}/s", in_rate, whole
    age_ms = uskin["age_p50_ms"]
    yield "overhead", "uSkin newest-sample age, p50", "≤ 2 ms", f"{age_ms} ms", age_ms <= 2, whole
