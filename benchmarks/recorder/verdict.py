"""Bars beside results; a part not run in full, or on a stretched rig, gets no verdict."""

from collections.abc import Iterator
from typing import Any

EPISODES = 50
KILLS = 20
TIMES = 10
HELD_s = {"mute_at_connect": 3.0, "wrong_version": 3.0}  # of these nothing moves: until the error
HELD_IN_s = 0.5  # of all others
# bar, what was asked, what was seen, whether met, whether run in full
Found = tuple[str, str, object, bool, bool]


def bars(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Return each bar with its verdict: ``met``, ``missed`` or ``not judged``."""
    parts = {"end_to_end": _end_to_end, "kill9": _kill9, "faults": _faults, "overhead": _overhead}
    rows = []
    for part, read in parts.items():
        if part not in result:
            continue
        is_judged = result["runs"][part]["judged"]
        for bar, asked, seen, is_met, is_whole in read(result[part]):
            verdict = "not judged"
            if is_whole and is_judged:
                verdict = "met" if is_met else "missed"
            rows.append({"bar": bar, "asked": asked, "seen": seen, "verdict": verdict})
    return rows


def _end_to_end(seen: dict[str, Any]) -> Iterator[Found]:
    whole = seen["episodes"] >= EPISODES
    lowest = seen["hz_lowest"]
    highest = seen["hz_highest"]
    in_beat = 29.7 <= lowest <= highest <= 30.3
    yield "mean rate of each episode", "30.0 ± 0.3 Hz", f"{lowest} to {highest} Hz", in_beat, whole
    ratio = seen["jitter_ratio"]
    yield "p99 tick jitter over the idle loop's", "≤ 3", ratio, ratio <= 3, whole
    yield "frames lost", "0", seen["lost_frames"], not seen["lost_frames"], whole
    loads = seen["loads_in_stock_lerobot"]
    yield "loads in stock LeRobot", "yes", loads, loads, whole
    yield "steps trained on it", "20", seen["trained_steps"], seen["trained_steps"] >= 20, whole
    # of a session that was ended early there is none
    for used in [used for used in seen["cores_used"] if used][-1:]:
        cores = round(used["recording_loop"] + used["storing_process"], 3)
        yield "recorder, two 640×480 cameras", "≤ 0.6 cores", f"{cores} cores", cores <= 0.6, whole


def _kill9(seen: dict[str, Any]) -> Iterator[Found]:
    trials = seen["trials"]
    lost = seen["saved_episodes_lost"]
    resumed = seen["resumed"]
    whole = trials >= KILLS
    yield f"saved episodes lost in {trials} kills", "0", lost, not lost, whole
    yield "sessions that went on after a kill", "all", resumed, resumed == trials, whole


def _faults(faults: dict[str, Any]) -> Iterator[Found]:
    for name, seen in faults.items():
        trials = seen["trials"]
        right = seen["right_outcome"]
        whole = trials >= TIMES
        yield f"{name}: right outcome", "all", f"{right} of {trials}", right == trials, whole
        worst_s = seen["worst_hold_s"]
        within_s = HELD_s.get(name, HELD_IN_s)
        if worst_s is not None:
            yield f"{name}: held", f"≤ {within_s} s", f"{worst_s} s", worst_s <= within_s, whole


def _overhead(seen: dict[str, Any]) -> Iterator[Found]:
    read_ms = seen["observation_read"]["p95_ms"]
    yield "observation read without images, p95", "≤ 3 ms", f"{read_ms} ms", read_ms <= 3, True
    uskin = seen["uskin"]
    whole = uskin["seconds"] >= 60
    lost = uskin["sent"] - uskin["samples"] + uskin["lost"] + uskin["bad"]
    in_rate = not lost and abs(uskin["rate_hz"] - 500) <= 10
    yield "uSkin scans lost at 500/s", "0", f"{lost} at {uskin['rate_hz']}/s", in_rate, whole
    age_ms = uskin["age_p50_ms"]
    yield "uSkin newest-sample age, p50", "≤ 2 ms", f"{age_ms} ms", age_ms <= 2, whole
