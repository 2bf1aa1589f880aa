"""A rig of stand-ins: arm and hand, a GelSight on the left finger, a uSkin on the right one, two scene cameras."""

from __future__ import annotations

import itertools
import json
import os
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import psutil

from benchmarks.recorder.plan import Plan
from benchmarks.recorder.session import Program, Session
from benchmarks.recorder.stillness import arm_clock, find_hold
from uniforce_robots.standins.fci.link import read_journal
from uniforce_robots.standins.fci.process import StandIn as ArmStandIn
from uniforce_robots.standins.process import StandIn

_numbers = itertools.count(2)
SCENE_CYCLE = ("rest_s=1", "press_s=1")
REST_s = 0.6  # after a fault, before the arm's log is read
REST_MAX_s = 2.0  # an arm that moves by then was never held
FREE_FRAMES = 60  # between two presses; a reference is taken from 10 in a row
CAMERAS = {"front": "gelsight", "wrist": "tactip"}  # any moving 640×480 picture will do


def new_address() -> str:
    """Return a loopback address of its own: the arm's ports are fixed, and trials may run side by side."""
    pid = os.getpid()
    return f"127.{pid % 250 + 1}.{pid // 250 % 250}.{next(_numbers) % 250}"


class Rig:
    """Stand-ins that run, sessions of ``uniforce record`` against them, and what breaks them; files in ``folder``."""

    def __init__(self, plan: Plan, folder: Path) -> None:
        self.plan, self.folder = plan, folder
        folder.mkdir(parents=True, exist_ok=True)
        self._program: Program | None = None
        with ExitStack() as undo:
            self._closing = undo
            self._start()
            self._closing = undo.pop_all()

    def _start(self) -> None:
        start, rate = self._closing.enter_context, f"rate_hz={self.plan.fps}"
        cycle = (f"rest_s={FREE_FRAMES / self.plan.fps}", "press_s=1")
        self.cameras = {
            name: start(StandIn("mjpeg", f"sensor={sensor}", rate, f"seed={seed}", *SCENE_CYCLE))
            for seed, (name, sensor) in enumerate(CAMERAS.items())
        }
        self.gelsight = start(StandIn("mjpeg", "sensor=gelsight", "seed=5", rate, *cycle))
        self.uskin = start(StandIn("slcan", f"rate_hz={self.plan.uskin_hz}", *cycle))
        self._closing.callback(lambda: self.arm.close())
        self.arm = ArmStandIn(new_address(), log=self._log)

    def session(self, root: Path, **settings: object) -> Session:
        """Begin ``uniforce record`` into a folder; the program it is forked from is loaded at the first."""
        if self._program is None:
            log = self.plan.folder / "sessions.log"
            self._program = self._closing.enter_context(Program(log, self.plan.patience))
        self._write_file()
        plain = {
            "robot": "franka",
            "rig": self._file,
            "teleop": "trial_circle",
            "operator": "unattended",
            "root": root,
            "repo_id": "local/trial",
            "prompts": "[go round]",
            "reserve_MB": 50.0,
            "late_share": 0.1 if self.plan.patience <= 1 else 0.9,
        } | settings
        attended = plain["operator"] == "keys"
        wait = {"drive_between": False} if attended else {"unwell_s": 10.0 * self.plan.patience}
        return Session(self._program, [f"{name}={value}" for name, value in (wait | plain).items()])

    def new_arm(self, *flags: str) -> None:
        """Take a fresh arm at a fresh address; the one before is let go."""
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
        self.arm.do("flush")
        return self._log.stat().st_size

    def rest(self, mark: int, fault_s: float) -> dict[str, Any]:
        """Wait until the arm rests; return when it was held, if ever, and how well its own clock ran.

        ``mark`` is where its log stood before the fault, which came at ``fault_s``, ``time.monotonic``.
        """
        deadline_s = time.monotonic() + REST_MAX_s * self.plan.patience
        hold = None
        while hold is None and time.monotonic() < deadline_s:
            time.sleep(REST_s)
            if self.arm.process.poll() is None:
                self.arm.do("flush")
            wire = read_journal(self._log, mark)
            hold = find_hold(wire, fault_s)
        return {"arm_clock": arm_clock(wire), **(hold or {})}

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.close()

    def _write_file(self) -> None:
        patience = self.plan.patience
        scene = {"type": "uniforce_scene", "width": 640, "height": 480, "max_age_ms": 200.0 * patience}
        cameras: dict[str, dict] = {n: {**scene, "source": s.address} for n, s in self.cameras.items()}
        cameras["tactile_left"] = {
            "type": "uniforce_tactile",
            "sensor": "gelsight",
            "finger": "left",
            "source": self.gelsight.address,
            "capture_width": 640,
            "capture_height": 480,
            "max_age_ms": 200.0 * patience,
        }
        cameras["tactile_right"] = {
            "type": "uniforce_uskin",
            "finger": "right",
            "link": "slcan",
            "source": self.uskin.address,
            "max_age_ms": 100.0 * patience,
        }
        robot = {
            "type": "uniforce_franka",
            "id": "trial",
            "calibration_dir": str(self.folder),
            "address": self.arm.address,
            "fps": float(self.plan.fps),
            "connect_deadline_s": 2.5 * patience,
            "guards": {"low": [0.1, -0.3, 0.1, -3.1416, 0.0], "high": [0.7, 0.3, 0.6, 3.1416, 0.08]},
            # 1 s is the hard limit of each; the hand's is never the first to be met when the controller dies.
            "stream": dict.fromkeys(("state_age_s", "stale_s"), min(0.2 * patience, 0.9)),
            "gripper": {"reading_age_s": min(0.5 * patience, 1.0)},
            "cameras": cameras,
        }
        teleop = {"type": "trial_circle", "tick_s": 1 / self.plan.fps}
        self._file.write_text(json.dumps({"robot": robot, "teleop": teleop}))
