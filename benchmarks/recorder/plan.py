"""How long and how often: the settings of all trials."""

from dataclasses import dataclass
from pathlib import Path

LONG_s = 30.0  # time limit of an episode that a fault shall end
EPISODES = 9999  # wanted by sessions that are ended from outside
START_s = 120.0  # until a session says its first line, or has ended
NOTICE_s = 20.0  # a fault that shows nothing by then never will


@dataclass(frozen=True)
class Plan:
    """What is tried.

    Attributes:
        work: folder for datasets, logs and ledgers.
        episodes, episode_s: of the end to end run.
        kills: with kill -9.
        times: each fault is injected.
        overhead_s, uskin_s: how long is measured.
        fps: ticks and camera frames per second; below 30 no bar is judged.
        patience: what limits of age and waiting times are multiplied by; above 1 no bar is judged.
        uskin_hz: scans per second of the finger in the rig.
        seed: of random moments.
    """

    work: Path
    episodes: int = 50
    episode_s: float = 4.0
    kills: int = 20
    times: int = 10
    overhead_s: float = 30.0
    uskin_s: float = 60.0
    fps: int = 30
    patience: float = 1.0
    uskin_hz: float = 500.0
    seed: int = 0

    @property
    def is_judged(self) -> bool:
        """Whether timings mean anything: the rig as it shall be, no limit stretched."""
        return self.patience == 1 and self.fps == 30
