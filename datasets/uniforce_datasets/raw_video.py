"""Raw tactile frames beside a dataset, e.g. ``raw/tactile_left/episode_000017.mp4``.

Not a LeRobot feature, on purpose: LeRobot hands every video key to a policy as a camera and decodes
it for every training sample. These are kept so that demonstrations survive a better canonicaliser,
and nothing else reads them.
"""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from uniforce_datasets.video_encoder import PerKeyEncoder
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import tactile_name

FOLDER = "raw"


def raw_path(root: Path, finger: Finger, episode: int) -> Path:
    """Return where the raw frames of an episode are."""
    return root / FOLDER / tactile_name(finger) / f"episode_{episode:06d}.mp4"


class RawVideo:
    """Encodes the raw frames of the running episode.

    Args:
        staged: the staging folder, made anew for each episode.
        shapes: (rows, columns, 3) of the raw frames by finger; empty stores none.
        encoder: shared by all fingers.
    """

    def __init__(
        self, staged: Path, shapes: Mapping[Finger, tuple[int, ...]], encoder: PerKeyEncoder
    ) -> None:
        self._staged = staged
        self._shapes = dict(shapes)
        self._encoder = encoder
        self._begun = False

    @property
    def dropped(self) -> dict[str, int]:
        """Frames lost in this episode, by stream."""
        return self._encoder.dropped

    def add(self, frames: Mapping[Finger, np.ndarray]) -> None:
        """Queue one frame of each finger; ContractError: other fingers or shapes than announced."""
        shapes = {finger: frame.shape for finger, frame in frames.items()}
        if shapes != self._shapes:
            do = "Announce every raw stream when the recorder is made."
            raise ContractError(expected("raw tactile frames", self._shapes, shapes, do))
        if self._shapes and not self._begun:
            self._encoder.start_episode(list(map(tactile_name, self._shapes)), self._staged)
            self._begun = True
        for finger, frame in frames.items():
            self._encoder.feed_frame(tactile_name(finger), frame)

    def save(self, episode: int) -> None:
        """Finish the videos and put them where the commit will take them from."""
        if not self._begun:
            return
        self._begun = False
        written = self._encoder.finish_episode()
        for finger in self._shapes:
            target = raw_path(self._staged, finger, episode)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(written[tactile_name(finger)][0], target)

    def cancel(self) -> None:
        """Forget the running episode."""
        self._encoder.cancel_episode()
        self._begun = False
