"""Which of the sensors' samples the rows hold: a camera and a loop of the same rate still slip past each other."""

from __future__ import annotations

from collections.abc import Iterator

from uniforce_recording.observation import Observation


class FrameCount:
    """Counts over one episode, by camera and finger.

    Repeated: rows that hold the sample of the row before. Skipped: samples that came and went between two rows; for
    taxels, those that were in no row's window.
    """

    def __init__(self) -> None:
        self._last: dict[str, int] = {}
        self._repeated: dict[str, int] = {}
        self._skipped: dict[str, int] = {}

    def add(self, seen: Observation) -> None:
        """Count one row."""
        for source, index, kept in _indices(seen):
            new = index - self._last.get(source, index - 1)
            self._repeated[source] = self._repeated.get(source, 0) + (new == 0)
            self._skipped[source] = self._skipped.get(source, 0) + max(new - kept, 0)
            self._last[source] = index

    def as_dict(self) -> dict[str, dict[str, int]]:
        """Return {source: {"repeated": …, "skipped": …}}."""
        return {s: {"repeated": self._repeated[s], "skipped": self._skipped[s]} for s in self._last}


def _indices(seen: Observation) -> Iterator[tuple[str, int, int]]:
    """Yield each source's name, newest index, and how many samples a row keeps."""
    for name, picture in seen.cameras.items():
        yield name, picture.index, 1
    for finger, touch in seen.fingers.items():
        yield finger, touch.index, 1 if touch.window is None else len(touch.window.times_s)
