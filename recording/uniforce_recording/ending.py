"""How an episode ended."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from uniforce_recording.ticker import TickStats

How = Literal["judged", "open", "aborted", "discard", "rerecord"]


@dataclass(frozen=True)
class Ending:
    """How an episode ended.

    Attributes:
        how: ``judged``, ``open`` (over, still to be judged), ``aborted``, or what the operator asked for.
        ticks: how the beat was kept.
        outcome: one of ``keys.OUTCOME_NAMES``; means something where judged.
        clean: whether it was a success without slip or excess force.
        cause: where aborted, one of ``keys.ABORT_CAUSES``.
        message: what happened, in words.
        held_s: from the beginning of the tick that met a fault until the rig was told to hold; 0 without a fault.
        notes: what the operator wrote.
        pauses: how often it was paused.
        frames: samples repeated and skipped by camera and finger.
        quits: whether the session shall end after it.
    """

    how: How
    ticks: TickStats
    outcome: str = "aborted"
    clean: bool = False
    cause: str = "none"
    message: str = ""
    held_s: float = 0.0
    notes: tuple[str, ...] = ()
    pauses: int = 0
    frames: dict[str, dict[str, int]] = field(default_factory=dict)
    quits: bool = False

    @property
    def label(self) -> str:
        """The ending in a word, e.g. ``success`` or ``aborted:stale_touch``."""
        if self.how == "aborted":
            return f"aborted:{self.cause}"
        return self.outcome if self.how == "judged" else self.how
