"""How long and how often: the settings of all trials, and the command line of a session."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from uniforce_recorder_trials.rig import Rig, RigOptions

LONG_s = 30.0  # time limit of an episode that a fault shall end
EPISODES = 9999  # wanted by sessions that somebody else ends


@dataclass(frozen=True)
class Plan:
    """What is tried.

    Attributes:
        work: folder for datasets, logs and ledgers.
        episodes, episode_s: of the end to end run.
        kills: with kill -9.
        times: each fault is injected.
        overhead_s, uskin_s: how long is measured.
        options: of the rig of stand-ins.
        seed: of random moments.
    """

    work: Path
    episodes: int = 50
    episode_s: float = 4.0
    kills: int = 20
    times: int = 10
    overhead_s: float = 30.0
    uskin_s: float = 60.0
    options: RigOptions = RigOptions()  # noqa: RUF009  frozen
    seed: int = 0

    @property
    def log(self) -> Path:
        """Everything that sessions said."""
        return self.work / "sessions.log"

    @property
    def patience(self) -> float:
        """What waiting times are multiplied by."""
        return self.options.patience

    @property
    def is_judged(self) -> bool:
        """Whether timings mean anything: the rig as it shall be, no limit stretched."""
        return self.options.patience == 1 and self.options.fps == 30

    def argv(self, rig: Rig, root: Path, **settings: object) -> list[str]:
        """Return what ``uniforce-record`` is called with."""
        plain = {
            "robot": "franka",
            "rig": rig.file,
            "teleop": "trial_circle",
            "operator": "nobody",
            "root": root,
            "repo_id": "local/trial",
            "prompts": "[go round]",
            "reserve_MB": 50.0,
            "late_share": 0.1 if self.patience <= 1 else 0.9,
        } | settings
        attended = plain["operator"] == "keys"
        wait = {"drive_between": False} if attended else {"unwell_s": 10.0 * self.patience}
        return [f"{name}={value}" for name, value in (wait | plain).items()]
