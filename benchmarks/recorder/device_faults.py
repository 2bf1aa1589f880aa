"""Faults while an episode runs: how each is made and mended, and what has to come of it."""

import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.ledger import Ledger
from benchmarks.recorder.end_to_end import BEGUN
from benchmarks.recorder.plan import EPISODES, LONG_s, NOTICE_s, START_s
from benchmarks.recorder.rig import Rig
from benchmarks.recorder.session import Line, Session, TrialError
from uniforce_datasets.cards import read_card
from uniforce_datasets.source import read_source
from uniforce_robots.standins.process import StandIn
from uniforce_vtla.errors import UniForceError

WAITING, STORED, REFUSED = r"is next: ", r"^(not )?stored", r"^can't begin"
UNDER_WAY_s = (0.7, 1.3)  # into an episode, before it is broken
UNWELL_s = 3.0  # then an unattended session gives up
FAULT = 3  # exit code
Action = Callable[[Rig], object]


@dataclass(frozen=True)
class Breakage:
    """A fault of a device, injected while an episode runs."""

    breaks: Action  # what is done to the stand-ins
    mends: Action
    # the episode may be stored with: the exact cause, or what may be seen first, since silence
    # comes before its reason
    labels: tuple[str, ...]
    clears: bool = False  # whether a person has to press ``v`` before the next episode


def _injected(stand_in: Callable[[Rig], StandIn], fault: str, *labels: str) -> Breakage:
    breaks, mends = (lambda rig, what=what: stand_in(rig).inject(what) for what in (fault, "none"))
    return Breakage(breaks, mends, tuple(f"aborted:{label}" for label in labels))


_camera = partial(_injected, lambda rig: rig.cameras["front"])
_uskin = partial(_injected, lambda rig: rig.uskin)


BREAKAGES: dict[str, Breakage] = {
    "camera_stops": _camera("stop", "lost_camera", "stale_camera"),
    "camera_goes_silent": _camera("stall", "stale_camera", "lost_camera"),
    "camera_freezes": _camera("freeze", "frozen_camera"),
    "uskin_garbage": _uskin("garbage", "bad_touch"),
    "uskin_stalls": _uskin("stall", "stale_touch"),
    "uskin_loses_taxels": _uskin("missing", "stale_touch"),
    "uskin_unplugged": _uskin("unplug", "lost_touch", "stale_touch"),
    "arm_reflex": Breakage(
        lambda rig: rig.arm.do("reflex"), lambda rig: None, ("aborted:robot_reflex",), True
    ),
}


def attended(faults: dict[str, Breakage], rig: Rig, ledger: Ledger, root: Path, times: int) -> None:
    """Inject each until it has ``times`` findings; a person goes on after each, quits in the end.

    That the session hung or died is a finding too; it ends then, and can be begun again. All faults
    share a dataset.
    """
    with rig.session(root, operator="keys", episodes=EPISODES, episode_s=LONG_s) as session:
        at, clears = 0, False
        for name, fault in faults.items():
            while len(ledger.read(name)) < times:
                try:
                    at = _begin(session, rig.plan.patience, at, clears)
                    at, found = _break(session, fault, rig, root, at, random.uniform(*UNDER_WAY_s))
                except UniForceError as error:
                    ledger.add(name, {"right_outcome": False, "message": str(error)})
                    return
                fault.mends(rig)
                ledger.add(name, found)
                clears = fault.clears
        session.wait_for(WAITING, START_s, at)
        session.press("q")
        if code := session.wait_end(START_s):
            raise TrialError(f"the session ended with exit code {code} though a person quit it")


def _begin(session: Session, patience: float, at: int, clears: bool) -> int:
    """Press keys until an episode runs; return the number of the line that says so."""
    deadline_s = time.monotonic() + (START_s + NOTICE_s) * patience
    at, _ = session.wait_for(WAITING, START_s, at)
    if clears:
        session.press("v")
        at, _ = session.wait_for(r"recovered", NOTICE_s, at)
    while True:
        session.press(" ")
        at, said = session.wait_for(f"{BEGUN}|{REFUSED}", START_s, at + 1)
        if not said.text.startswith("can't"):
            return at
        if time.monotonic() > deadline_s:
            raise TrialError(f"no episode begins: {said.text}")
        # a busy computer stopped the arm between two faults: a person lets it go on
        if "reference" not in said.text:
            session.press("v")
        time.sleep(0.1)


def _break(
    session: Session, fault: Breakage, rig: Rig, root: Path, at: int, under_way_s: float
) -> tuple[int, dict[str, Any]]:
    """Break it a while into the episode; return what terminal, dataset and the arm's log say."""
    time.sleep(under_way_s)
    mark, broken_s = rig.mark(), time.monotonic()
    fault.breaks(rig)
    at, said = session.wait_for(STORED, NOTICE_s, at)
    return at, finding(fault, root, said, broken_s, rig.rest(mark, broken_s))


def finding(
    fault: Breakage, root: Path, said: Line, broken_s: float, held: dict[str, Any]
) -> dict[str, Any]:
    """Return what came of a fault that was stored with this line."""
    label = said.text.removeprefix("stored ").partition(",")[0]
    card = read_card(root, len(read_source(root).episodes) - 1)
    is_right = label in fault.labels and card["label"] == label and "hold_s" in held
    return {
        "label": label,
        "message": card["message"],
        "right_outcome": is_right,
        "stored_s": round(said.time_s - broken_s, 3),
        **held,
    }


def unattended(name: str, fault: Breakage, rig: Rig) -> dict[str, Any]:
    """Inject it once and leave it: the session gives up, and its exit code says why."""
    root = rig.plan.folder / "faults" / f"{name}_unattended{time.time_ns()}"
    rig.new_arm()
    with rig.session(root, episodes=1, episode_s=LONG_s, unwell_s=UNWELL_s) as session:
        at, _ = session.wait_for(BEGUN, START_s + NOTICE_s)
        _, found = _break(session, fault, rig, root, at, UNDER_WAY_s[0])
        code = session.wait_end(START_s + UNWELL_s)
    return found | {"right_outcome": found["right_outcome"] and code == FAULT, "exit_code": code}
