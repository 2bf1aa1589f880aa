"""kill -9 at random moments: what was saved stays, and the next session goes on."""

import random
import signal
import time
from collections import Counter
from pathlib import Path
from typing import Any

import psutil

from benchmarks.ledger import Ledger
from benchmarks.recorder.end_to_end import BEGUN
from benchmarks.recorder.loading import load_in_stock_lerobot
from benchmarks.recorder.plan import EPISODES, Plan, START_s
from benchmarks.recorder.rig import Rig
from uniforce_datasets.lossless import check_dataset
from uniforce_robots.recorder.assemble import judged_episodes

MOMENTS = ("tick", "save", "between")
VICTIMS = ("all", "loop", "store")  # every process of it, the loop alone, the storing process alone
EPISODE_s = 1.5
# late or not is judged in end_to_end; here episodes must be stored
SHORT = {"episode_s": EPISODE_s, "late_share": 1.0}
STORED = r"^stored success"
WAIT_s = 60.0
RANDOM_s = {  # after the line that says: episode begun, or stored
    "tick": (0.1, EPISODE_s),
    "save": (EPISODE_s, EPISODE_s + 0.6),
    "between": (0.0, 0.5),
}


def run(plan: Plan, ledger: Ledger) -> dict[str, Any]:
    """Kill as often as is still missing, then let a last session go on and end by itself."""
    root = plan.folder / "kill9" / "data"
    left = plan.kills - len(ledger.read("kill9"))
    if left > 0 or not ledger.read("kill9_last"):
        with Rig(plan, plan.folder / "kill9") as rig:
            for _ in range(left):
                ledger.add("kill9", kill_once(rig, root, len(ledger.read("kill9"))))
            ledger.add("kill9_last", finish(rig, root))
    return _sum(ledger.read("kill9"), ledger.read("kill9_last")[-1])


def kill_once(rig: Rig, root: Path, number: int) -> dict[str, Any]:
    """Resume, let an episode be stored, kill at a random moment of the next; see what is left."""
    rng = random.Random(number)
    moment = MOMENTS[number % 3]
    victim = VICTIMS[number // 3 % 3]
    before = _episodes(root)
    rig.new_arm()
    settings: dict[str, Any] = {"episodes": EPISODES} | SHORT
    if before:
        settings |= resumed(root)
    with rig.session(root, **settings) as session:
        at, _ = session.wait_for(STORED, START_s + WAIT_s)
        if moment != "between":
            session.wait_for(BEGUN, WAIT_s, at + 1)
        time.sleep(rng.uniform(*RANDOM_s[moment]))
        family = session.processes()
        for process in {"all": family, "loop": family[:1], "store": family[1:]}[victim]:
            process.send_signal(signal.SIGKILL)
        code = session.wait_end(WAIT_s)
        alive = psutil.wait_procs(family, WAIT_s * rig.plan.patience)[1]
        said = len(session.said(STORED))
    has = _load(root, before)
    return {
        "moment": moment,
        "victim": victim,
        "exit_code": code,
        "episodes_before": before,
        "said_stored": said,
        "episodes_after": has,
        "saved_lost": max(before + said - has, 0),
        "processes_left": len(alive),
    }


def resumed(root: Path) -> dict[str, Any]:
    """Return the settings that go on with a dataset; a new rig's stand-ins have new addresses."""
    return {"resume": root, "settings_changed": "accept"}


def _episodes(root: Path) -> int:
    if not (root / "meta" / "info.json").is_file():
        return 0
    return len(check_dataset(root).episodes)


def _load(root: Path, first: int = 0) -> int:
    """Check all episodes, read those from a number on with LeRobot's own class; return how many."""
    count = _episodes(root)
    if count:
        load_in_stock_lerobot(root, first)
    return count


def finish(rig: Rig, root: Path) -> dict[str, Any]:
    rig.new_arm()
    before = _episodes(root)
    wanted = judged_episodes(root, before) + 1  # aborted ones don't count
    with rig.session(root, episodes=wanted, **SHORT, **resumed(root)) as session:
        code = session.wait_end(START_s + WAIT_s)
    return {"exit_code": code, "episodes_before": before, "episodes_after": _load(root)}


def _sum(trials: list[dict[str, Any]], last: dict[str, Any]) -> dict[str, Any]:
    went_on = sum(trial["said_stored"] > 0 for trial in trials[1:])
    return {
        "trials": len(trials),
        "saved_episodes_lost": sum(trial["saved_lost"] for trial in trials),
        "resumed": went_on + (last["exit_code"] == 0),
        "episodes_at_the_end": last["episodes_after"],
        "processes_left": sum(trial["processes_left"] for trial in trials),
        "moments": dict(Counter(f"{trial['moment']}/{trial['victim']}" for trial in trials)),
    }
