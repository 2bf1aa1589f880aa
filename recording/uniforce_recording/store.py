"""Where rows go: what the loop needs of a recorder, wherever it runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_recording.rig import RigFacts
from uniforce_recording.rows import further_columns
from uniforce_vtla.contracts import Finger

LOCK_WAIT_s = 20.0  # a session that was killed leaves a storing process that finishes what it was told first


class Store(Protocol):
    """See ``EpisodeRecorder``, which is one."""

    @property
    def num_episodes(self) -> int: ...  # noqa: D102

    @property
    def num_frames(self) -> int: ...  # noqa: D102

    @property
    def total_frames(self) -> int: ...  # noqa: D102

    @property
    def features(self) -> dict[str, dict]: ...  # noqa: D102

    def add(  # noqa: D102
        self, frame: Mapping[str, Any], task: str, raw: Mapping[Finger, np.ndarray] | None = None
    ) -> None: ...

    def save(  # noqa: D102
        self,
        success: bool,
        outcome: str,
        seed: int,
        cause: str = "none",
        card: Mapping[str, Any] | None = None,
    ) -> None: ...

    def discard(self) -> None: ...  # noqa: D102

    def close(self) -> None: ...  # noqa: D102


@dataclass(frozen=True)
class StoreSettings:
    """Where to, and how.

    Attributes:
        root: the dataset's folder.
        repo_id: LeRobot's name for it.
        reserve_MB: must stay free on the disk.
        queue_frames: that may wait per video; 60 are 2 s of a busy computer.
        own_process: whether video is encoded in a process of its own, so that it can't delay a tick.
    """

    root: Path
    repo_id: str
    reserve_MB: float = 500.0
    queue_frames: int = 60
    own_process: bool = True


def open_recorder(facts: RigFacts, settings: StoreSettings) -> EpisodeRecorder:
    """Return the recorder of a rig's columns, in this process.

    Raises:
        DatasetError: another recorder writes there, or the dataset has other features.
    """
    return EpisodeRecorder(
        settings.root,
        settings.repo_id,
        facts.sensors["left"],
        facts.sensors["right"],
        facts.fps,
        cameras=facts.cameras,
        truth=facts.truth,
        realtime=facts.paced,
        queue_frames=settings.queue_frames,
        further=further_columns(facts),
        raw_shapes=facts.raw_frames,
        lock_wait_s=LOCK_WAIT_s,
    )
