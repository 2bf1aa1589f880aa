"""A rig of stand-ins: an arm, a GelSight on the left finger, a uSkin right, two scene cameras."""

from __future__ import annotations

import itertools
import json
import os
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.recorder.plan import Plan
from benchmarks.recorder.session import Program, Session
from uniforce_robots.standins.fci.link import read_journal
from uniforce_robots.standins.fci.process import StandIn as ArmStandIn
from uniforce_robots.standins.process import StandIn

_numbers = itertools.count(2)
SCENE_CYCLE = ("rest_s=1", "press_s=1")
REST_s = 0.6  # after a fault, before the arm's log is read
REST_MAX_s = 2.0  # an arm that moves by then was never held
FREE_FRAMES = 60  # between two presses; a reference is taken from 10 in a row
CAMERAS = {"front": "gelsight", "wrist": "tactip"}  # any moving 640×480 picture will do


# half the speed of the circle: below it for good, the arm's target has stopped and it brakes
SLOW_m_s = 0.03
SPAN_s = 0.02  # a speed is measured over
REST_m = 1e-3  # so near to where it ends the arm rests
STILL_m = 5e-4  # how far it may still creep
WATCHED_s = 0.3  # at the end


def find_hold(wire: Sequence[dict], fault_s: float) -> dict[str, float] | None:
    """Return "hold_s", until it began to brake for good, and "rest_s", until it was at rest.

    Seconds from the fault at ``fault_s``, ``time.monotonic``, 0 for what was so before it; None
    where the arm went on moving. At rest is within 1 mm of where it stayed. ``wire`` is the arm's
    log from the fault until well after the rest.
    """
    states = [line for line in wire if line["what"] == "state"]
    if not states:
        return None
    times_s = np.array([state["time_s"] for state in states])
    places_m = np.array([state["position_m"] for state in states])
    away_m = np.linalg.norm(places_m - places_m[-1], axis=1)
    if away_m[times_s > times_s[-1] - WATCHED_s].max() > STILL_m:
        return None
    moments = {"hold_s": _speeds_m_s(times_s, places_m) > SLOW_m_s, "rest_s": away_m > REST_m}
    found = {}
    for name, is_so in moments.items():
        found[name] = round(float(times_s[is_so].max(initial=fault_s)) - fault_s, 3)
    return found


def _speeds_m_s(times_s: np.ndarray, places_m: np.ndarray) -> np.ndarray:
    before = np.searchsorted(times_s, times_s - SPAN_s)
    span_s = np.maximum(times_s - times_s[before], SPAN_s / 2)
    speeds: np.ndarray = np.linalg.norm(places_m - places_m[before], axis=1) / span_s
    return speeds


def arm_clock(wire: Sequence[dict]) -> float | None:
    """Return the milliseconds the arm lived through per millisecond of ours; None without a log.

    The stand-in waits for its client. Where the machine starves one of them the arm's time runs
    slower than ours, its braking included; 1.0: a hold was measured on an arm that keeps time.
    """
    states = [line for line in wire if line["what"] == "state"]
    if len(states) < 2:
        return None
    lived_s = (states[-1]["id"] - states[0]["id"]) / 1000
    return round(lived_s / (states[-1]["time_s"] - states[0]["time_s"]), 3)


def new_address() -> str:
    """Return a loopback address of its own: the arm's ports are fixed, trials run side by side."""
    pid = os.getpid()
    return f"127.{pid % 250 + 1}.{pid // 250 % 250}.{next(_numbers) % 250}"


class Rig:
    """Stand-ins, sessions of ``uniforce record`` against them, and what breaks them."""

    def __init__(self, plan: Plan, folder: Path) -> None:
        self.plan = plan
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._program: Program | None = None
        with ExitStack() as undo:
            self._closing = undo
            self._start()
            self._closing = undo.pop_all()

    def _start(self) -> None:
        start = self._closing.enter_context
        rate = f"rate_hz={self.plan.fps}"
        cycle = (f"rest_s={FREE_FRAMES / self.plan.fps}", "press_s=1")
        self.cameras = {}
        for seed, (name, sensor) in enumerate(CAMERAS.items()):
            self.cameras[name] = start(
                StandIn("mjpeg", f"sensor={sensor}", rate, f"seed={seed}", *SCENE_CYCLE)
            )
        self.gelsight = start(StandIn("mjpeg", "sensor=gelsight", "seed=5", rate, *cycle))
        self.uskin = start(StandIn("slcan", f"rate_hz={self.plan.uskin_hz}", *cycle))
        self._closing.callback(lambda: self.arm.close())
        self.arm = ArmStandIn(new_address(), log=self._log)

    def session(self, root: Path, **settings: object) -> Session:
        """Begin ``uniforce record`` into a folder; the first loads the program behind it."""
        patience = self.plan.patience
        if self._program is None:
            log = self.plan.folder / "sessions.log"
            self._program = self._closing.enter_context(Program(log, patience))
        self._write_file()
        words = {
            "robot": "franka",
            "rig": self._file,
            "teleop": "trial_circle",
            "operator": "unattended",
            "root": root,
            "repo_id": "local/trial",
            "prompts": "[go round]",
            "reserve_MB": 50.0,
            "late_share": 0.1 if patience <= 1 else 0.9,
        } | settings
        if words["operator"] == "keys":
            words.setdefault("drive_between", False)
        else:
            words.setdefault("unwell_s", 10.0 * patience)
        return Session(self._program, [f"{name}={value}" for name, value in words.items()])

    def new_arm(self, *flags: str) -> None:
        self.arm.close()
        self.arm = ArmStandIn(new_address(), *flags, log=self._log)

    @property
    def _log(self) -> Path:
        return self.folder / "wire.jsonl"

    @property
    def _file(self) -> Path:
        return self.folder / "rig.json"

    @property
    def pids(self) -> list[int]:
        owned = [*self.cameras.values(), self.gelsight, self.uskin]
        pids = [standin.process.pid for standin in owned] + [self.arm.process.pid]
        return [pid for pid in pids if psutil.pid_exists(pid)]

    def mark(self) -> int:
        """Return where the arm's log stands now, for ``rest``."""
        return self._log.stat().st_size

    def rest(self, mark: int, fault_s: float) -> dict[str, Any]:
        """Wait until the arm rests; return when it was held, if ever, and how well its clock ran.

        ``mark`` is where its log stood before the fault, which came at ``fault_s``,
        ``time.monotonic``.
        """
        deadline_s = time.monotonic() + REST_MAX_s * self.plan.patience
        hold = None
        while hold is None and time.monotonic() < deadline_s:
            time.sleep(REST_s)
            wire = read_journal(self._log, mark)
            hold = find_hold(wire, fault_s)
        return {"arm_clock": arm_clock(wire), **(hold or {})}

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.close()

    def _write_file(self) -> None:
        patience = self.plan.patience
        picture_age_ms = min(200.0 * patience, 1000.0)
        cameras: dict[str, dict] = {}
        for name, stand_in in self.cameras.items():
            cameras[name] = {
                "type": "uniforce_scene",
                "width": 640,
                "height": 480,
                "max_age_ms": picture_age_ms,
                "source": stand_in.address,
            }
        cameras["tactile_left"] = {
            "type": "uniforce_tactile",
            "sensor": "gelsight",
            "finger": "left",
            "source": self.gelsight.address,
            "capture_width": 640,
            "capture_height": 480,
            "max_age_ms": picture_age_ms,
        }
        cameras["tactile_right"] = {
            "type": "uniforce_uskin",
            "finger": "right",
            "link": "slcan",
            "source": self.uskin.address,
            "max_age_ms": min(100.0 * patience, 1000.0),
        }
        state_age_s = min(0.2 * patience, 0.9)
        robot = {
            "type": "uniforce_franka",
            "id": "trial",
            "calibration_dir": str(self.folder),
            "address": self.arm.address,
            "fps": float(self.plan.fps),
            "connect_deadline_s": 2.5 * patience,
            "guards": {
                "low": [0.1, -0.3, 0.1, -3.1416, 0.0],
                "high": [0.7, 0.3, 0.6, 3.1416, 0.08],
            },
            # 1 s is the hard limit of each; the hand's is never met first when the controller dies
            "stream": {"state_age_s": state_age_s, "stale_s": state_age_s},
            "gripper": {"reading_age_s": min(0.5 * patience, 1.0)},
            "cameras": cameras,
        }
        teleop = {"type": "trial_circle", "tick_s": 1 / self.plan.fps}
        self._file.write_text(json.dumps({"robot": robot, "teleop": teleop}))
