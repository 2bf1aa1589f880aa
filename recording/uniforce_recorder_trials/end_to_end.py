"""Fifty short episodes by the real client, beside a loop that does nothing: rate, jitter, lost frames, training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import psutil

from uniforce_datasets.cards import read_card
from uniforce_datasets.source import read_source
from uniforce_recorder_trials.cpu import CpuMeter, machine_facts
from uniforce_recorder_trials.idle_loop import IdleLoop
from uniforce_recorder_trials.ledger import Ledger
from uniforce_recorder_trials.loading import load_in_stock_lerobot, train_a_little
from uniforce_recorder_trials.plan import Plan
from uniforce_recorder_trials.rig import Rig
from uniforce_recorder_trials.session import Line, Program, Session
from uniforce_vtla.keys import STAMPS, index_key, time_key

BEGUN, OVER = r"^episode \d+/\d+: ", r"^over: "
START_s = 120.0
EPISODE_MAX = 4.0  # times its length: waiting for references and storing included


def run(plan: Plan, ledger: Ledger) -> dict[str, Any]:
    """Record what is missing of the episodes; return the findings of all of them."""
    root = plan.work / "end_to_end" / "data"
    if _saved(root) < plan.episodes:
        with Rig(plan.work / "end_to_end", plan.options) as rig, Program(plan.log) as program:
            ledger.add("end_to_end", record(plan, rig, program, root))
    sessions = ledger.read("end_to_end")
    found = rate_and_jitter(root, sessions) | {
        "cores_used": [session["cores_used"] for session in sessions],
        "machine": [session["machine"] for session in sessions],
    }
    return found | load_in_stock_lerobot(root) | train_a_little(root, plan.work / "end_to_end" / "train")


def _saved(root: Path) -> int:
    return len(read_source(root).episodes) if (root / "meta" / "info.json").is_file() else 0


def record(plan: Plan, rig: Rig, program: Program, root: Path) -> dict[str, Any]:
    """Record until all episodes are there, an idle loop beside it; return what can't be read from the dataset."""
    idle = IdleLoop(plan.options.fps)
    argv = plan.argv(rig, root, episodes=plan.episodes, episode_s=plan.episode_s)
    with Session(program, argv) as session:
        session.wait_for(BEGUN, START_s * plan.patience)
        meter = CpuMeter(_who(session, rig, idle))
        session.wait_for(OVER, EPISODE_MAX * plan.episode_s * plan.patience)
        wanted_s = plan.episodes * plan.episode_s * EPISODE_MAX * plan.patience
        session.wait_for(rf"{plan.episodes}/{plan.episodes} episodes", wanted_s)
        cores_used = meter.read()
        code = session.wait_end(START_s * plan.patience)
        spans_s = spans(session.lines)
    beat_s, late_ms = idle.stop()
    recorded = np.any([(beat_s >= a) & (beat_s <= b) for a, b in spans_s], axis=0)
    return {
        "exit_code": code,
        "idle_late_ms": late_ms[recorded].tolist(),
        "cores_used": cores_used,
        "machine": machine_facts(),
    }


def _who(session: Session, rig: Rig, idle: IdleLoop) -> dict[str, list[psutil.Process]]:
    loop, *children = session.processes()
    return {
        "recording_loop": [loop],
        "storing_process": children,
        "stand_ins": [psutil.Process(pid) for pid in rig.pids],
        "idle_loop": [psutil.Process(idle.pid)],
        "trial_harness": [psutil.Process()],
    }


def spans(lines: list[Line]) -> list[tuple[float, float]]:
    """Return when each episode began and was over."""
    begun_s = [line.time_s for line in lines if line.text.startswith("episode ")]
    over_s = [line.time_s for line in lines if line.text.startswith(("over: ", "stored aborted"))]
    return list(zip(begun_s, over_s, strict=False))


def rate_and_jitter(root: Path, sessions: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what the stored stamps say of the beat, beside the idle loop's."""
    source = read_source(root)
    columns = source.columns((STAMPS, index_key("front"), index_key("wrist"), time_key("front")))
    hz, late_ms, missed, behind = [], [], 0, 0
    labels: dict[str, int] = {}
    for episode in source.episodes:
        rows = slice(episode.start, episode.start + episode.length)
        tick_s = columns[STAMPS][rows, 0]
        hz.append((len(tick_s) - 1) / (tick_s[-1] - tick_s[0]))
        late, skipped = lateness_ms(tick_s, source.fps)
        late_ms.append(late)
        missed += skipped
        card = read_card(root, episode.index)
        labels[card["label"]] = labels.get(card["label"], 0) + 1
        behind += (
            sum(sensor["lost"] for sensor in card["sensors"].values())
            if episode is source.episodes[-1]
            else 0
        )
    idle_ms = np.concatenate([session["idle_late_ms"] for session in sessions])
    ticks_ms = np.concatenate(late_ms)
    observed_ms = 1e3 * (columns[STAMPS][:, 1] - columns[STAMPS][:, 0])
    dropped = labels.get("aborted:dropped_frame", 0)
    p99_ms, idle_p99_ms = float(np.percentile(ticks_ms, 99)), float(np.percentile(idle_ms, 99))
    return {
        "episodes": len(source.episodes),
        "labels": labels,
        "frames": source.num_frames,
        "hz": round(float(np.mean(hz)), 3),
        "hz_lowest": round(float(np.min(hz)), 3),
        "hz_highest": round(float(np.max(hz)), 3),
        "tick_jitter_p50_ms": round(float(np.median(ticks_ms)), 3),
        "tick_jitter_p99_ms": round(p99_ms, 3),
        "idle_jitter_p50_ms": round(float(np.median(idle_ms)), 3),
        "idle_jitter_p99_ms": round(idle_p99_ms, 3),
        "jitter_ratio": round(p99_ms / max(idle_p99_ms, 1e-6), 2),
        "idle_ticks": len(idle_ms),
        "lost_frames": missed + dropped,
        "ticks_missed": missed,
        "episodes_with_dropped_video": dropped,
        "sensor_samples_lost": behind,
        "observation_with_images_p95_ms": round(float(np.percentile(observed_ms, 95)), 2),
    }


def lateness_ms(tick_s: np.ndarray, fps: int) -> tuple[np.ndarray, int]:
    """Return (how late each tick came after its deadline, ms, deadlines missed), as the ticker counts them.

    Args:
        tick_s: (N,) stored times of ticks; the first one sets the beat.
        fps: of the beat.
    """
    period_s, due_s, missed = 1 / fps, float(tick_s[0]), 0
    late_s = np.zeros(len(tick_s))
    for number, now_s in enumerate(tick_s):
        late_s[number] = max(now_s - due_s, 0.0)
        skipped = int(late_s[number] / period_s)
        missed += skipped
        due_s += (1 + skipped) * period_s
    return 1e3 * late_s, missed
