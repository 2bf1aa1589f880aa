"""One recorded episode as people look at it: arrays that every form of the view draws from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from uniforce_vtla.evaluation.episode import ScoreLimits
from uniforce_vtla.evaluation.finger_estimates import FingerEstimate, FingerSettings
from uniforce_vtla.evaluation.telling_moments import Stretch, stretches


@dataclass(frozen=True, eq=False)
class Moment:
    """One frame worth looking at.

    Attributes:
        name: why, e.g. "lifted".
        frame: its number in the episode.
        cameras: (H, W, 3) uint8 RGB by camera.
        markers: (H, W, 3) uint8 overlay of reference and current, by finger.
        raw: (H, W, 3) uint8 RGB of what the sensor gave, by finger; only those that were kept.
    """

    name: str
    frame: int
    cameras: dict[str, np.ndarray]
    markers: dict[str, np.ndarray]
    raw: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class EpisodeStory:
    """An episode of n frames with two fingers, left before right in every array.

    Attributes:
        title: dataset and episode.
        time_s: (n,).
        films: evenly spaced (H, W, 3) uint8 RGB pictures by camera.
        force_N: (n, 2, 3) estimates, canonical frame.
        true_force_N: the same from a simulator; None for a robot's recording.
        change: by finger, (n, g, g, L) latent minus its free-air latent, as the sensor sees it.
        moments: in order of time.
        found: what the estimates mean; None where that can't be told.
        truth: what the true forces mean.
        judges_slip: whether the pads' friction is known.
        note: why ``found`` is None.
    """

    title: str
    time_s: np.ndarray
    films: dict[str, list[np.ndarray]]
    force_N: np.ndarray
    true_force_N: np.ndarray | None
    change: dict[str, np.ndarray]
    moments: tuple[Moment, ...]
    found: FingerEstimate | None
    truth: FingerEstimate | None
    judges_slip: bool
    note: str = ""

    def strength(self, finger: str) -> np.ndarray:
        """Return (n, g, g): how far each patch's latent is from free air."""
        return np.linalg.norm(self.change[finger], axis=-1)

    @property
    def stretches(self) -> list[Stretch]:
        """Where an estimate lies beyond its limit."""
        return [] if self.found is None else stretches(self.found, ScoreLimits(), FingerSettings())

    @property
    def verdict(self) -> list[str]:
        """The estimated events in words."""
        if self.found is None:
            return [f"events can't be estimated: {self.note}"]
        unjudged = [] if self.judges_slip else ["slippage isn't judged: the pads' friction wasn't given"]
        return [*_events(self.found), *unjudged]

    @property
    def true_verdict(self) -> list[str]:
        """The same judged by true forces; empty where there are none."""
        return [] if self.truth is None else _events(self.truth)


def _events(found: FingerEstimate) -> list[str]:
    return [*found.lost, *found.slippage, *found.excess_force] or ["no event"]
