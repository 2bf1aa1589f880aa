"""OpenCV painter."""

from __future__ import annotations

import numpy as np

from lerobot_env_uniforce_wiping.simulation import WipeSimulation


class Painter:
    def reset(self, sim: WipeSimulation) -> None:
        pass

    def render(self) -> list[np.ndarray]:
        return [np.zeros((224, 224, 3), np.uint8)] * 2

    def close(self) -> None:
        pass
