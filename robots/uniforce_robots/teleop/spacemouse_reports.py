"""HID reports of a SpaceMouse → deflection of six axes and buttons.

Two layouts are in use. Older: report 1 = x, y, z and report 2 = turns about them, int16 little endian. Newer: all six
in report 1. Report 3 = buttons, one bit each. The device's own axes: x right, y towards the person, z down.
"""

from __future__ import annotations

import struct

import numpy as np

from uniforce_robots.sensors.sources import SourceCounts

AXES = 6
BUTTONS = 2  # left and right; more exist on some models and mean nothing here
LARGEST_COUNT = 2000  # full deflection is some 350; beyond this it is no deflection
_THREE, _SIX = struct.Struct("<3h"), struct.Struct("<6h")


class SpaceMouseReports:
    """Collects reports into a state (8,) float64: x, y, z, turns about x, y, z in counts, left and right button."""

    def __init__(self) -> None:
        self._state = np.zeros(AXES + BUTTONS)
        self._samples = self._bad = 0

    @property
    def counts(self) -> SourceCounts:
        """Reports understood and not."""
        return SourceCounts(self._samples, 0, self._bad)

    @property
    def state(self) -> np.ndarray:
        """(8,) the newest state, a copy."""
        return self._state.copy()

    def forget(self) -> None:
        """Go back to rest, as a device does that is plugged in anew."""
        self._state[:] = 0

    def feed(self, report: bytes) -> bool:
        """Take one report, its id in the first byte; return whether it said anything."""
        understood = self._take(report[0], report[1:]) if report else False
        self._samples += understood
        self._bad += not understood
        return understood

    def _take(self, report_id: int, body: bytes) -> bool:
        if report_id == 1 and len(body) >= _SIX.size:
            return self._put(0, _SIX.unpack_from(body))
        if report_id in (1, 2) and _THREE.size <= len(body) < _SIX.size:
            return self._put(3 * (report_id - 1), _THREE.unpack_from(body))
        if report_id == 3 and body:
            self._state[AXES:] = [(body[0] >> bit) & 1 for bit in range(BUTTONS)]
            return True
        return report_id > 3 and bool(body)  # battery level, calibration, LEDs: known to exist, not needed

    def _put(self, first: int, values: tuple[int, ...]) -> bool:
        if max(map(abs, values)) > LARGEST_COUNT:
            return False
        self._state[first : first + len(values)] = values
        return True
