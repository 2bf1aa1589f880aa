"""A rig of stand-ins: arm and hand, a GelSight on the left finger, a uSkin on the right one, two scene cameras."""

from __future__ import annotations

import itertools
import json
import os
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from uniforce_recorder_trials.stillness import arm_clock, find_hold
from uniforce_standins.fci.journal import read_journal
from uniforce_standins.fci.process import StandIn as ArmStandIn
from uniforce_standins.process import StandIn

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


@dataclass(frozen=True)
class RigOptions:
    """What the rig is like.

    Attributes:
        fps: ticks and camera frames per second; below 30 no bar is judged.
        patience: what limits of age are multiplied by; above 1 no bar is judged.
        uskin_hz: scans per second.
        keep_wire: whether the arm writes down every message, 1000 states and commands a second.
    """

    fps: int = 30
    patience: float = 1.0
    uskin_hz: float = 500.0
    keep_wire: bool = True


class Rig:
    """Stand-ins that run, the rig file for ``uniforce-record``, and hands to break things with.

    Args:
        folder: for the rig file and the wire's log.
        options: what it is like.
    """

    def __init__(self, folder: Path, options: RigOptions | None = None) -> None:
        self.folder, self.options = folder, options or RigOptions()
        folder.mkdir(parents=True, exist_ok=True)
        self._closing = ExitStack()
        with ExitStack() as undo:
            undo.callback(self._closing.close)
            self._start()
            undo.pop_all()

    def _start(self) -> None:
        start, rate = self._closing.enter_context, f"rate_hz={self.options.fps}"
        cycle = (f"rest_s={FREE_FRAMES / self.options.fps}", "press_s=1")
        self.cameras = {
            name: start(StandIn("mjpeg", f"sensor={sensor}", rate, f"seed={seed}", *SCENE_CYCLE))
            for seed, (name, sensor) in enumerate(CAMERAS.items())
        }
        self.gelsight = start(StandIn("mjpeg", "sensor=gelsight", "seed=5", rate, *cycle))
        self.uskin = start(StandIn("slcan", f"rate_hz={self.options.uskin_hz}", *cycle))
        self.arm = self.new_arm()

    def new_arm(self, *flags: str) -> ArmStandIn:
        """Return a fresh arm at a fresh address, the rig file pointing to it; the one before is let go."""
        if hasattr(self, "arm"):
            self.arm.close()
        self.arm = ArmStandIn(new_address(), *flags, log=self._log if self.options.keep_wire else None)
        self._write_file()
        return self.arm

    @property
    def _log(self) -> Path:
        return self.folder / "wire.jsonl"

    @property
    def file(self) -> Path:
        """What ``rig=`` gets."""
        return self.folder / "rig.json"

    @property
    def pids(self) -> list[int]:
        """Of every stand-in."""
        owned = [*self.cameras.values(), self.gelsight, self.uskin]
        pids = [standin._process.pid for standin in owned] + [self.arm.process.pid]
        return [pid for pid in pids if psutil.pid_exists(pid)]

    def mark(self) -> int:
        """Return where the arm's log stands now, for ``wire``."""
        self.arm.do("flush")
        return self._log.stat().st_size

    def wire(self, mark: int = 0) -> list[dict]:
        """Return what the arm wrote down since a mark."""
        if self.arm.process.poll() is None:
            self.arm.do("flush")
        return read_journal(self._log, mark)

    def rest(self, mark: int, fault_s: float) -> dict[str, Any]:
        """Wait until the arm rests; return when it was held and how well its own clock ran.

        Args:
            mark: where its log stood before the fault.
            fault_s: when it was broken, ``time.monotonic``; no hold is returned where it never rests.
        """
        deadline_s = time.monotonic() + REST_MAX_s * self.options.patience
        hold = None
        while hold is None and time.monotonic() < deadline_s:
            time.sleep(REST_s)
            wire = self.wire(mark)
            hold = find_hold(wire, fault_s)
        return {"arm_clock": arm_clock(wire), **(hold.as_dict() if hold else {})}

    def close(self) -> None:
        """End every stand-in."""
        if hasattr(self, "arm"):
            self.arm.close()
        self._closing.close()

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _write_file(self) -> None:
        patience = self.options.patience
        scene = {"type": "uniforce_scene", "width": 640, "height": 480, "max_age_ms": 200.0 * patience}
        cameras: dict[str, dict] = {
            name: {**scene, "source": standin.address} for name, standin in self.cameras.items()
        }
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
            "fps": float(self.options.fps),
            "connect_deadline_s": 2.5 * patience,
            "guards": {"low": [0.1, -0.3, 0.1, -3.1416, 0.0], "high": [0.7, 0.3, 0.6, 3.1416, 0.08]},
            # 1 s is the hard limit of each; the hand's is never the first to be met when the controller dies.
            "stream": dict.fromkeys(("state_age_s", "stale_s"), min(0.2 * patience, 0.9)),
            "gripper": {"reading_age_s": min(0.5 * patience, 1.0)},
            "cameras": cameras,
        }
        teleop = {"type": "trial_circle", "tick_s": 1 / self.options.fps}
        self.file.write_text(json.dumps({"robot": robot, "teleop": teleop}))
