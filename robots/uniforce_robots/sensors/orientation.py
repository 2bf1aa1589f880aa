"""How a patch or camera is turned on its finger: raw stays raw, what is shown is brought upright.

Which way a uSkin's rows run on a finger wasn't seen on hardware, so it is a setting, and ``uniforce touch
check=orientation`` finds it. A camera may sit at any angle; ``check=angle`` finds that.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from uniforce_vtla.contracts import TAXEL_SHAPE
from uniforce_vtla.errors import ContractError, expected

TURNS = (0, 90, 180, 270)
SIDE = 4  # taxels per side
FULL_SCALE = 65_535


@dataclass(frozen=True)
class Orientation:
    """Mirror first (left and right change places), then turn; ContractError: no angle of one turn."""

    rotation_deg: float = 0  # counter-clockwise as the marker image shows it, from 0 to below 360; taxels by quarters
    flip: bool = False  # mirrored; for taxels whose columns run the other way, never for a camera

    def __post_init__(self) -> None:
        if not 0 <= self.rotation_deg < 360:
            do = "Give degrees, counter-clockwise."
            raise ContractError(expected("rotation_deg", "from 0 to below 360", self.rotation_deg, do))

    def upright(self, raw: np.ndarray) -> np.ndarray:
        """Return (16, 3) uint16 counts, or a camera frame (H, W, 3), as if mounted straight."""
        return self.of_counts(raw) if raw.ndim == 2 else self.of_frame(raw)

    def of_counts(self, counts: np.ndarray) -> np.ndarray:
        """Return (16, 3) uint16 counts with taxels moved to their place and shear turned along.

        Counts are unsigned around mid-scale, so turning shear round mirrors it there; differences to a reference that
        was turned likewise come out exactly turned. Turns by quarters only: configs of taxels allow no others.
        """
        # rows from the bottom, columns from the left; x right, y up
        grid: np.ndarray = counts.reshape(SIDE, SIDE, 3).copy()
        if self.flip:
            grid = grid[:, ::-1].copy()
            grid[..., 0] = FULL_SCALE - grid[..., 0]
        for _ in range(round(self.rotation_deg / 90)):
            grid = np.rot90(grid, -1).copy()  # rows run upwards: rot90's clockwise is the image's other way
            grid[..., 0], grid[..., 1] = FULL_SCALE - grid[..., 1], grid[..., 0].copy()
        return grid.reshape(TAXEL_SHAPE)

    def of_frame(self, frame: np.ndarray) -> np.ndarray:
        """Return a camera frame (H, W, 3) turned; by quarters exactly, else about its middle and of its own size."""
        turned = frame[:, ::-1] if self.flip else frame
        if self.rotation_deg in TURNS:
            return np.ascontiguousarray(np.rot90(turned, round(self.rotation_deg / 90)))
        height, width = frame.shape[:2]
        turn = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), self.rotation_deg, 1.0)
        return cv2.warpAffine(np.ascontiguousarray(turned), turn, (width, height), borderMode=cv2.BORDER_REPLICATE)
