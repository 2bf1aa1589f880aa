"""Settings of all trials: faults, durations, repetitions."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from uniforce_vtla.options import Count, Names, OutFile, OutFolder, Positive, Range, Text

LONG_s = 30.0  # time limit of an episode that a fault shall end
EPISODES = 9999  # wanted by sessions that are ended from outside
START_s = 120.0  # until a session says its first line, or has ended
NOTICE_s = 20.0  # a fault that shows nothing by then never will
Parts = Annotated[str, Names(("end_to_end", "kill9", "faults", "overhead"), many=True)]
Fps = Annotated[int, Range(1, 120)]


@dataclass
class Plan:
    """Record, kill and break, and write what came of it to a file; run it again to go on.

    Everything, on an idle machine: python -m benchmarks.recorder
    One part, for example: python -m benchmarks.recorder only=faults faults=arm_reflex
    On a busy machine, to try it: python -m benchmarks.recorder fps=5 patience=20 uskin_hz=50 …
    Needs the extra `franka`. The arm, fingers and cameras are stand-ins; nothing here is hardware.
    """

    only: Parts = ""  # end_to_end | kill9 | faults | overhead, comma between; empty = all
    faults: Text = ""  # of faults: only these, comma between
    episodes: Count = 50  # of the end to end run
    episode_s: Positive = 4.0  # s, each of them
    kills: Count = 20  # with kill -9
    times: Count = 10  # each fault is injected
    overhead_s: Positive = 30.0  # s, how long the arm and hand are read
    uskin_s: Positive = 60.0  # s, how long the taxels' full rate is measured
    fps: Fps = 30  # ticks and camera frames per second; below 30 no bar is judged
    # what limits of age and waiting times are multiplied by; above 1 no bar is judged
    patience: Positive = 1.0
    uskin_hz: Positive = 500.0  # scans per second of the finger in the rig
    fresh: bool = False  # forget what earlier runs found
    work: OutFolder = "outputs/recorder_trials"  # datasets, logs, findings so far
    out: OutFile = "outputs/recorder.json"  # result file; parts not run keep what it says

    @property
    def folder(self) -> Path:
        """Where everything goes: sessions run elsewhere, so from the root on."""
        return Path(self.work).resolve()

    @property
    def is_judged(self) -> bool:
        """Whether timings mean anything: the rig as it shall be, no limit stretched."""
        return self.patience == 1 and self.fps == 30
