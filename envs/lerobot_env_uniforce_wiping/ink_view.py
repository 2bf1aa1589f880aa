"""The writing as a camera sees it: the ink grid warped onto the picture."""

from __future__ import annotations

import cv2
import numpy as np

from lerobot_env_uniforce_wiping.cameras import CAMERA_PX, Camera
from lerobot_env_uniforce_wiping.ink import PIXEL_m
from lerobot_env_uniforce_wiping.simulation import WipeSimulation

INK_COLOUR = np.array([30, 30, 120], dtype=np.float32)
MARGIN = 1  # clear cells around the writing


class InkView:
    """Paints the current ink of a scene; warps only the part of the board that was written on."""

    def __init__(self, sim: WipeSimulation) -> None:
        self._ink, self._data = sim.ink, sim.data
        self._board = sim.model.body("board").id
        rows, columns = np.nonzero(sim.ink.ink)
        self._rows = slice(rows.min() - MARGIN, rows.max() + 1 + MARGIN)
        self._columns = slice(columns.min() - MARGIN, columns.max() + 1 + MARGIN)
        x0 = (self._rows.start + 0.5 - sim.ink.rows / 2) * PIXEL_m
        y0 = (self._columns.start + 0.5 - sim.ink.columns / 2) * PIXEL_m
        self._to_board = np.array([[0, PIXEL_m, x0], [PIXEL_m, 0, y0], [0, 0, 0]])  # (column, row, 1) → board
        self._colour = np.minimum(INK_COLOUR * np.array(sim.scene.light_gain, dtype=np.float32), 255)
        self._version = -1
        self._cover: np.ndarray = np.zeros((1, 1), np.uint8)

    def _texture(self) -> np.ndarray:
        if self._version != self._ink.version:
            self._cover = (self._ink.ink[self._rows, self._columns] * 255).astype(np.uint8)
            self._version = self._ink.version
        return self._cover

    def paint(self, picture: np.ndarray, camera: Camera) -> None:
        """Blend the ink over a (224, 224, 3) picture."""
        cover = self._texture()
        homography = self._homography(camera)
        height, width = cover.shape
        corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]]) @ homography.T
        if corners[:, 2].min() <= 0:  # partly behind the camera: the hand is over the tray, nothing to see
            return
        spots = corners[:, :2] / corners[:, 2:]
        low = np.clip(np.floor(spots.min(axis=0)).astype(int) - 1, 0, CAMERA_PX)
        high = np.clip(np.ceil(spots.max(axis=0)).astype(int) + 2, 0, CAMERA_PX)
        if (high <= low).any():
            return
        shift = np.array([[1, 0, -low[0]], [0, 1, -low[1]], [0, 0, 1]])
        patch = cv2.warpPerspective(cover, shift @ homography, tuple(int(v) for v in high - low))
        part = picture[low[1] : high[1], low[0] : high[0]]
        rows, columns = np.nonzero(patch)
        alpha = (patch[rows, columns] / 255)[:, None]
        part[rows, columns] = part[rows, columns] * (1 - alpha) + self._colour * alpha

    def _homography(self, camera: Camera) -> np.ndarray:
        axes = self._data.xmat[self._board].reshape(3, 3)
        to_camera = camera.rotation @ axes @ self._to_board
        to_camera[:, 2] += camera.rotation @ (self._data.xpos[self._board] - camera.position_m)
        half = CAMERA_PX / 2
        lens = np.array([[camera.focal_px, 0, half], [0, camera.focal_px, half], [0, 0, 1.0]])
        return lens @ to_camera
