"""What a reader needs of a device: open, read what came, close."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np


class Stamped(NamedTuple):
    """A sample as a source delivers it: when (``samples.now_ns`` clock) and what."""

    stamp_ns: int
    data: np.ndarray


@dataclass(frozen=True)
class SourceCounts:
    """What a source met since it was made; reconnecting doesn't reset it.

    Attributes:
        samples: whole samples delivered.
        lost: samples that began and never became whole.
        bad: pieces that could not be understood: lines, frames, images.
    """

    samples: int = 0
    lost: int = 0
    bad: int = 0


class SampleSource(Protocol):
    """One device.  All calls come from one thread; ``read`` blocks for a tenth of a second or so at most."""

    name: str

    @property
    def counts(self) -> SourceCounts:
        """What was met so far."""
        ...

    def open(self) -> None:
        """Connect; raise SensorError where that fails, within seconds."""
        ...

    def read(self) -> list[Stamped]:
        """Return what came since the last call, oldest first, maybe nothing; raise SensorError once lost."""
        ...

    def close(self) -> None:
        """Let go of the device; never raises, may be called twice."""
        ...


class USkinSource(SampleSource, Protocol):
    """A uSkin patch: every sample is (16, 3) uint16 raw counts, x y z of each taxel, whole scans only.

    Raw means before any baseline: what the patch measured is what a dataset stores.
    """
