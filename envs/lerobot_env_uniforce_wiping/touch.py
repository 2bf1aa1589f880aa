"""Contact truth of a pad → its marker image."""

from __future__ import annotations

import numpy as np

from lerobot_env_uniforce_wiping.simulation import WipeSimulation
from uniforce_vtla.contracts import Finger


class PadImages:
    def __init__(self, sensor: str, finger: Finger) -> None:
        self.reference = np.zeros((480, 640, 3), np.uint8)

    def image(self, sim: WipeSimulation) -> np.ndarray:
        return self.reference
