"""A camera that does as its test says, in place of ``cv2.VideoCapture``."""

from __future__ import annotations

import time

import numpy as np


class ScriptedCapture:
    """Remembers every ``set`` in order; counts up in its pixels while it ``changes``, fails unless it ``works``."""

    def __init__(self, rows: int = 48, columns: int = 64) -> None:
        self.asked: list[tuple[int, float]] = []
        self.values: dict[int, float] = {}
        self.refuses: set[int] = set()
        self.opens = self.works = self.changes = True
        self.count = self.released = 0
        self.frame = np.zeros((rows, columns, 3), np.uint8)
        self.frame[:, :4] = 255  # a mark at the left edge

    def isOpened(self) -> bool:  # noqa: N802
        return self.opens

    def set(self, prop: int, value: float) -> bool:
        self.asked.append((prop, value))
        if prop not in self.refuses:
            self.values[prop] = value
        return prop not in self.refuses

    def get(self, prop: int) -> float:
        return self.values.get(prop, 0.0)

    def read(self) -> tuple[bool, np.ndarray | None]:
        time.sleep(0.002)
        self.count += self.changes
        self.frame[:, 4:, 0] = self.count % 250  # blue in OpenCV's order
        return (True, self.frame.copy()) if self.works else (False, None)

    def release(self) -> None:
        self.released += 1
