"""Fifty short episodes by the real client, beside a loop that does nothing: rate, jitter, loss."""

import logging
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.ledger import Ledger
from benchmarks.recorder.loading import load_in_stock_lerobot, train_a_little
from benchmarks.recorder.machine import CpuMeter, IdleLoop, machine_facts
from benchmarks.recorder.plan import Plan, START_s
from benchmarks.recorder.rig import Rig
from benchmarks.recorder.session import Session, TrialError
from uniforce_datasets.cards import read_card
from uniforce_datasets.source import read_source
from uniforce_robots.recorder.assemble import judged_episodes
from uniforce_vtla.errors import expected
from uniforce_vtla.keys import STAMPS

log = logging.getLogger(__name__)
BEGUN = r"^episode \d+/\d+: "
SESSIONS = 5  # on a machine that starves it a session may end before its time
EPISODE_MAX = 4.0  # times its length: waiting for references and storing included


def run(plan: Plan, ledger: Ledger) -> dict[str, Any]:
    """Record what is missing of the episodes; return the findings; TrialError: all end early."""
    folder = plan.folder / "end_to_end"
    root = folder / "data"
    if _judged(root) < plan.episodes:
        with Rig(plan, folder) as rig:
            for _ in range(SESSIONS):
                ledger.add("end_to_end", record(rig, root))
                if _judged(root) >= plan.episodes:
                    break
                rig.new_arm()
    if _judged(root) < plan.episodes:
        came = f"{_judged(root)} after {SESSIONS} sessions"
        do = f"See {plan.folder}/sessions.log."
        raise TrialError(expected("end to end", f"{plan.episodes} episodes", came, do))
    sessions = ledger.read("end_to_end")
    found = rate_and_jitter(root, sessions)
    found["sessions"] = len(sessions)
    for key in ("cores_used", "machine"):
        found[key] = [session[key] for session in sessions]
    return found | load_in_stock_lerobot(root) | train_a_little(root, folder / "train")


def _judged(root: Path) -> int:
    if not (root / "meta" / "info.json").is_file():
        return 0
    return judged_episodes(root, len(read_source(root).episodes))


def record(rig: Rig, root: Path) -> dict[str, Any]:
    """Record all episodes, an idle loop beside it; return what can't be read from the dataset."""
    plan = rig.plan
    cores_used: dict[str, float] = {}
    settings = {"episodes": plan.episodes, "episode_s": plan.episode_s}
    with IdleLoop(plan.fps) as idle, rig.session(root, **settings) as session:
        try:
            session.wait_for(BEGUN, START_s)
            meter = CpuMeter(_who(session, rig, idle))
            wanted_s = plan.episodes * plan.episode_s * EPISODE_MAX
            session.wait_for(rf"{plan.episodes}/{plan.episodes} episodes", wanted_s)
            cores_used = meter.read()
        except TrialError as error:
            log.warning("%s", error)  # what it stored counts, and the exit code says how it ended
        code = session.wait_end(START_s)
        begun = session.said(BEGUN)
        beat_s, late_ms = idle.stop()
    recorded = np.zeros(len(beat_s), bool)
    for line in begun:
        recorded |= (beat_s >= line.time_s) & (beat_s <= line.time_s + plan.episode_s)
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


def rate_and_jitter(root: Path, sessions: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what the stored stamps say of the beat, beside the idle loop's."""
    source = read_source(root)
    stamps_s = source.columns((STAMPS,))[STAMPS]
    cards = []
    hz = []
    late = []
    missed = 0
    for episode in source.episodes:
        cards.append(read_card(root, episode.index))
        tick_s = stamps_s[episode.start : episode.start + episode.length, 0]
        hz.append((len(tick_s) - 1) / (tick_s[-1] - tick_s[0]))
        of_episode, skipped = lateness_ms(tick_s, source.fps)
        late.append(of_episode)
        missed += skipped
    idle = [session["idle_late_ms"] for session in sessions]
    p50_ms, p99_ms = np.percentile(np.concatenate(late), (50, 99)).tolist()
    idle_p50_ms, idle_p99_ms = np.percentile(np.concatenate(idle), (50, 99)).tolist()
    labels = Counter(card["label"] for card in cards)
    dropped = labels["aborted:dropped_frame"]
    return {
        "episodes": len(source.episodes),
        "labels": dict(labels),
        "frames": source.num_frames,
        "hz": round(float(np.mean(hz)), 3),
        "hz_lowest": round(float(np.min(hz)), 3),
        "hz_highest": round(float(np.max(hz)), 3),
        "tick_jitter_p50_ms": round(p50_ms, 3),
        "tick_jitter_p99_ms": round(p99_ms, 3),
        "idle_jitter_p50_ms": round(idle_p50_ms, 3),
        "idle_jitter_p99_ms": round(idle_p99_ms, 3),
        "jitter_ratio": round(p99_ms / max(idle_p99_ms, 1e-6), 2),
        "idle_ticks": sum(map(len, idle)),
        "lost_frames": missed + dropped,
        "ticks_missed": missed,
        "episodes_with_dropped_video": dropped,
        "taxel_scans_lost": cards[-1]["sensors"]["tactile_right"]["lost"],
        "observation_with_images_p95_ms": round(observe_p95_ms(stamps_s), 2),
    }


def observe_p95_ms(stamps_s: np.ndarray) -> float:
    """Return how long observing took, images included, of (N, 3) ``provenance.stamps``."""
    return 1e3 * float(np.percentile(stamps_s[:, 1] - stamps_s[:, 0], 95))


def lateness_ms(tick_s: np.ndarray, fps: int) -> tuple[np.ndarray, int]:
    """Return how late each of (N,) ticks came, ms, and the missed deadlines."""
    period_s = 1 / fps
    due_s = float(tick_s[0])
    missed = 0
    late_s = np.zeros(len(tick_s))
    for number, now_s in enumerate(tick_s):
        late_s[number] = max(now_s - due_s, 0.0)
        skipped = int(late_s[number] / period_s)
        missed += skipped
        due_s += (1 + skipped) * period_s
    return 1e3 * late_s, missed
