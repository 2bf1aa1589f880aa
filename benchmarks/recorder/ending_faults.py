"""Faults that end a session or keep it from starting: a fresh session for each."""

from __future__ import annotations

import errno
import os
import random
import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.recorder.device_faults import UNDER_WAY_s
from benchmarks.recorder.end_to_end import BEGUN
from benchmarks.recorder.kill9 import STORED
from benchmarks.recorder.plan import LONG_s, NOTICE_s, START_s
from benchmarks.recorder.rig import Rig
from benchmarks.recorder.session import Session
from uniforce_datasets.cards import read_card
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.source import read_source
from uniforce_vtla.keys import STAMPS

COULD_NOT_START, FAULT, DISK_FULL, INTERRUPTED = 2, 3, 4, 130
GONE = tuple(f"aborted:robot_{how}" for how in ("connection", "hand_connection", "stale", "ended"))
TWICE_s = (0.02, 0.6)  # between the two Ctrl-C
# of the small disk; kept free; left free by what fills it up
DISK_MB, RESERVE_MB, LEFT_MB = 250, 50, 30
SHORT_s = 1.5  # time limit of an episode that ends by itself
FEW_s = 10.0  # of one that fits on the small disk
MB = 1_000_000
PAGE_B = 4096
ROOM_MB = 300  # where it can't be mounted: between what is free now and the guard's limit


@dataclass(frozen=True)
class Bench:
    """Parts of a trial."""

    rig: Rig
    root: Path
    rng: random.Random

    def session(self, **settings: object) -> Session:
        return self.rig.session(self.root, **settings)

    def into_an_episode(self, session: Session, after: int = 0) -> int:
        """Wait until an episode is under way; return the number of the line that says so."""
        at, _ = session.wait_for(BEGUN, START_s + NOTICE_s, after)
        time.sleep(self.rng.uniform(*UNDER_WAY_s))
        return at


def server_death(bench: Bench) -> dict[str, Any]:
    """The arm's process vanishes with its log: the rows say when it was held."""
    bench.rig.new_arm()
    with bench.session(episodes=1, episode_s=LONG_s) as session:
        bench.into_an_episode(session)
        died = time.time()
        bench.rig.arm.die()
        code = session.wait_end(START_s)
    card = _last_card(bench.root)
    held_s = _held_at(bench.root, card) - died
    right = code == FAULT and card["label"] in GONE
    return _found(right, code, card["label"], card["message"]) | {"hold_s": round(held_s, 3)}


def mute_at_connect(bench: Bench) -> dict[str, Any]:
    """The arm accepts a connection and never answers."""
    return _refused(bench, ("--mute",), "none after")


def wrong_version(bench: Bench) -> dict[str, Any]:
    """The arm's software speaks another version; the error has both numbers."""
    return _refused(bench, ("--server-version", "9"), r"9.*10|10.*9")


def disk_full_guard(bench: Bench) -> dict[str, Any]:
    """Another program fills the disk below the reserve: the tick stops, the episode still fits."""
    with SmallDisk(bench.root, DISK_MB) as disk:
        bench.rig.new_arm()
        settings = {"episodes": 1, "episode_s": FEW_s, "reserve_MB": disk.reserve_MB(RESERVE_MB)}
        with bench.session(**settings) as session:
            bench.into_an_episode(session)
            mark, full_s = bench.rig.mark(), time.monotonic()
            disk.fill(LEFT_MB, RESERVE_MB)
            code = session.wait_end(START_s)
            held = bench.rig.rest(mark, full_s)
        card = _last_card(bench.root)
        right = code == DISK_FULL and card["label"] == "aborted:disk_full" and "hold_s" in held
        said = _found(right, code, card["label"], card["message"])
        return said | held | {"disk": disk.kind}


def disk_full_for_real(bench: Bench) -> dict[str, Any]:
    """No byte left and no guard: the error is typed, what was saved stays, the code is right."""
    with SmallDisk(bench.root, DISK_MB) as disk:
        if not disk.is_own:
            return {
                "right_outcome": None,
                "message": "needs a disk of its own: mount -t tmpfs was refused",
            }
        bench.rig.new_arm()
        with bench.session(episodes=9, episode_s=SHORT_s, reserve_MB=0.0) as session:
            at, _ = session.wait_for(STORED, START_s + NOTICE_s)
            at = bench.into_an_episode(session, at)
            disk.fill(0, 0)
            code = session.wait_end(START_s)
            said = [line.text for line in session.lines[at:] if "stored" in line.text]
        saved = len(check_dataset(bench.root).episodes)
        last = said[-1] if said else ""
        right = code == DISK_FULL and saved >= 1
        return _found(right, code, last.partition(":")[0], last) | {"saved": saved}


def ctrl_c_twice(bench: Bench) -> dict[str, Any]:
    """The second one may cut the storing short: labelled ``aborted:interrupt`` or not there."""
    bench.rig.new_arm()
    with bench.session(episodes=1, episode_s=LONG_s) as session:
        bench.into_an_episode(session)
        mark, first_s = bench.rig.mark(), time.monotonic()
        session.press("\x03")
        time.sleep(bench.rng.uniform(*TWICE_s))
        session.press("\x03")
        code = session.wait_end(START_s)
        last = session.lines[-1].text if session.lines else ""
    held = bench.rig.rest(mark, first_s)
    is_stored = (bench.root / "meta" / "info.json").is_file() and check_dataset(bench.root).episodes
    label = _last_card(bench.root)["label"] if is_stored else "not stored"
    right = (
        code == INTERRUPTED and label in ("aborted:interrupt", "not stored") and "hold_s" in held
    )
    return _found(right, code, label, last) | held


ENDINGS: dict[str, Callable[[Bench], dict[str, Any]]] = {
    "server_death": server_death,
    "mute_at_connect": mute_at_connect,
    "wrong_version": wrong_version,
    "disk_full": disk_full_guard,
    "disk_full_for_real": disk_full_for_real,
    "ctrl_c_twice": ctrl_c_twice,
}


def _refused(bench: Bench, flags: tuple[str, ...], says: str) -> dict[str, Any]:
    bench.rig.new_arm(*flags)
    with bench.session(episodes=1, episode_s=SHORT_s) as session:
        code = session.wait_end(START_s)
        refusals = session.said(r"^uniforce record: ")
        loaded = session.said("client loaded")
        named = session.said(says)
    took_s = refusals[-1].time_s - loaded[0].time_s if refusals and loaded else None
    right = code == COULD_NOT_START and bool(named) and took_s is not None
    took = {} if took_s is None else {"hold_s": round(took_s, 3)}
    return _found(right, code, "no episode", refusals[-1].text if refusals else "") | took


def _found(right: bool, code: int, label: str, message: str) -> dict[str, Any]:
    return {"right_outcome": right, "exit_code": code, "label": label, "message": message}


def _last_card(root: Path) -> dict[str, Any]:
    return read_card(root, len(read_source(root).episodes) - 1)


def _held_at(root: Path, card: dict[str, Any]) -> float:
    """Return when the rig was held, ``time.time``: the first tick without a row; its length."""
    source = read_source(root)
    last_tick_s = float(np.atleast_2d(source.columns((STAMPS,))[STAMPS])[-1, 0])
    return (
        datetime.fromisoformat(card["begun"]).timestamp()
        + last_tick_s
        + 1 / source.fps
        + card["held_s"]
    )


class SmallDisk:
    """A folder on a small disk; ``is_own``: it could be mounted, and can really be filled up."""

    def __init__(self, root: Path, size_MB: int) -> None:
        self._root = root
        self._ballast: list[Path] = []
        root.mkdir(parents=True, exist_ok=True)
        if root.is_mount():  # of a trial that was cut short
            subprocess.run(["umount", str(root)], check=True)
        mount = ["mount", "-t", "tmpfs", "-o", f"size={size_MB}m", "uniforce-trial", str(root)]
        self.is_own = (
            shutil.which("mount") is not None
            and not subprocess.run(mount, capture_output=True).returncode
        )

    @property
    def kind(self) -> str:
        return "tmpfs of its own" if self.is_own else "guard's limit raised to the free space"

    def reserve_MB(self, wanted_MB: float) -> float:  # noqa: N802  units
        """Return the guard's limit."""
        return wanted_MB if self.is_own else shutil.disk_usage(self._root).free / MB - ROOM_MB

    def fill(self, left_MB: float, reserve_MB: float) -> None:
        """Take all room but ``left_MB`` of an own disk, else enough to get below the limit."""
        free = shutil.disk_usage(self._root).free
        size = free - int(left_MB * MB) if self.is_own else int((ROOM_MB + reserve_MB) * MB)
        path = (
            self._root.parent / f".{self._root.name}-ballast"
            if not self.is_own
            else self._root / ".ballast"
        )
        self._ballast.append(path)
        with path.open("wb") as file:
            _take(file.fileno(), size)

    def __enter__(self) -> SmallDisk:
        return self

    def __exit__(self, *_: object) -> None:
        for path in self._ballast:
            path.unlink(missing_ok=True)
        if self.is_own:
            subprocess.run(["umount", str(self._root)], check=True)


def _take(file: int, size: int) -> None:
    """Allocate bytes, or as many as there are: a recorder takes some meanwhile."""
    taken, step = 0, size
    while taken < size and step >= PAGE_B:
        try:
            os.posix_fallocate(file, taken, min(step, size - taken))
            taken += step
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            step //= 2
