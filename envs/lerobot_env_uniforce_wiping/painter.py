"""Camera pictures without GL: primitives projected and painted far to near with OpenCV.

Flat shaded, deterministic on every machine, about 2 ms for both cameras. Order is fixed where it matters:
table, board, ink, then everything else by distance.
"""

from __future__ import annotations

import cv2
import mujoco
import numpy as np

from lerobot_env_uniforce_wiping.cameras import CAMERA_PX, Camera, front_camera, wrist_camera
from lerobot_env_uniforce_wiping.ink import PIXEL_m
from lerobot_env_uniforce_wiping.simulation import WipeSimulation

BACKGROUND = (206, 212, 218)
INK_COLOUR = np.array([30, 30, 120], dtype=np.float32)
LIGHT = np.array([0.45, 0.25, 0.86])  # direction towards the light, world frame
AMBIENT = 0.62
NEAR_m = 0.012  # nothing closer is painted
SUBPIXEL = 4  # fractional bits of polygon corners
CIRCLE = np.stack([np.cos(np.linspace(0, 2 * np.pi, 17)[:-1]), np.sin(np.linspace(0, 2 * np.pi, 17)[:-1])], -1)
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
FACES = (  # corner indices in order, outward normal axis and sign
    ((4, 6, 7, 5), 0, 1),
    ((0, 1, 3, 2), 0, -1),
    ((2, 3, 7, 6), 1, 1),
    ((0, 4, 5, 1), 1, -1),
    ((1, 5, 7, 3), 2, 1),
    ((0, 2, 6, 4), 2, -1),
)
HIDDEN_GROUP = 4  # collision pads: what is drawn is the same skin for every sensor


class Painter:
    """Paints the two cameras of a scene."""

    def reset(self, sim: WipeSimulation) -> None:
        """Start painting a new scene."""
        self._sim, model = sim, sim.model
        first = [model.geom("table").id, model.geom("board").id]
        seen = [g for g in range(model.ngeom) if model.geom_group[g] != HIDDEN_GROUP and g not in first]
        self._ground, self._things = first, seen
        self._colours = (model.geom_rgba[:, :3] * 255).astype(np.float64)

    def render(self) -> list[np.ndarray]:
        """Return the front and wrist pictures, (224, 224, 3) uint8 RGB each."""
        scene, data = self._sim.scene, self._sim.data
        return [self._paint(front_camera(scene)), self._paint(wrist_camera(scene, data))]

    def close(self) -> None:
        """Nothing to free."""

    def _paint(self, camera: Camera) -> np.ndarray:
        picture = np.empty((CAMERA_PX, CAMERA_PX, 3), np.uint8)
        picture[:] = BACKGROUND
        for geom in self._ground:
            self._paint_geom(picture, camera, geom)
        self._paint_ink(picture, camera)
        away = np.linalg.norm(self._sim.data.geom_xpos[self._things] - camera.position_m, axis=1)
        for index in np.argsort(-away):
            self._paint_geom(picture, camera, self._things[index])
        return picture

    def _paint_geom(self, picture: np.ndarray, camera: Camera, geom: int) -> None:
        if self._sim.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            self._paint_box(picture, camera, geom)
        else:
            self._paint_capsule(picture, camera, geom)

    def _paint_box(self, picture: np.ndarray, camera: Camera, geom: int) -> None:
        center = self._sim.data.geom_xpos[geom]
        axes = self._sim.data.geom_xmat[geom].reshape(3, 3)
        size = self._sim.model.geom_size[geom]
        local = camera.to_camera(center + (CORNERS * size) @ axes.T)
        for corners, axis, sign in FACES:
            normal = sign * axes[:, axis]
            middle = center + normal * size[axis]
            if normal @ (middle - camera.position_m) < 0:
                self._fill(picture, camera, clip_near(local[list(corners)]), self._shade(geom, normal))

    def _paint_capsule(self, picture: np.ndarray, camera: Camera, geom: int) -> None:
        radius, half = self._sim.model.geom_size[geom][:2]
        axis = self._sim.data.geom_xmat[geom].reshape(3, 3)[:, 2] * half
        ends = camera.to_camera(self._sim.data.geom_xpos[geom] + np.stack([axis, -axis]))
        if ends[:, 2].min() < radius + NEAR_m:
            return
        rings = [end + np.pad(CIRCLE, ((0, 0), (0, 1))) * radius for end in ends]
        corners = camera.to_pixels(np.concatenate(rings)).astype(np.float32)
        hull = cv2.convexHull(corners)[:, 0]
        self._fill_pixels(picture, hull, self._shade(geom, np.array([0.6, 0.0, 0.8])))

    def _shade(self, geom: int, normal: np.ndarray) -> tuple[float, ...]:
        bright = AMBIENT + (1 - AMBIENT) * max(float(normal @ LIGHT), 0.0)
        return tuple(float(c) for c in self._colours[geom] * bright)

    def _fill(self, picture: np.ndarray, camera: Camera, local: np.ndarray, colour: tuple[float, ...]) -> None:
        if len(local) >= 3:
            self._fill_pixels(picture, camera.to_pixels(local), colour)

    @staticmethod
    def _fill_pixels(picture: np.ndarray, corners: np.ndarray, colour: tuple[float, ...]) -> None:
        fixed = np.round(np.clip(corners, -4000, 4000) * (1 << SUBPIXEL)).astype(np.int32)
        cv2.fillConvexPoly(picture, fixed, colour, cv2.LINE_AA, SUBPIXEL)

    def _paint_ink(self, picture: np.ndarray, camera: Camera) -> None:
        ink, data = self._sim.ink, self._sim.data
        board = data.body("board")
        axes = board.xmat.reshape(3, 3)
        # texture pixel (column, row, 1) → world → camera → pixel, as one homography
        cell = np.array(
            [[0, PIXEL_m, -ink.rows / 2 * PIXEL_m], [PIXEL_m, 0, -ink.columns / 2 * PIXEL_m], [0, 0, 0]]
        )
        to_camera = camera.rotation @ (axes @ cell)
        to_camera[:, 2] += camera.rotation @ (board.xpos - camera.position_m)
        lens = np.array([[camera.focal_px, 0, CAMERA_PX / 2], [0, camera.focal_px, CAMERA_PX / 2], [0, 0, 1]])
        homography = lens @ to_camera
        cover = cv2.warpPerspective(ink.ink, homography, (CAMERA_PX, CAMERA_PX), flags=cv2.INTER_LINEAR)
        self._hide_behind(cover, homography, ink.ink.shape)
        rows, columns = np.nonzero(cover > 0.02)
        alpha = cover[rows, columns][:, None]
        picture[rows, columns] = picture[rows, columns] * (1 - alpha) + INK_COLOUR * alpha

    @staticmethod
    def _hide_behind(cover: np.ndarray, homography: np.ndarray, shape: tuple[int, ...]) -> None:
        """Blank pixels whose ray meets the ink's plane behind the camera."""
        corners = np.array([[0, 0, 1], [shape[1], 0, 1], [0, shape[0], 1], [shape[1], shape[0], 1]])
        if (corners @ homography[2]).min() > 0:
            return
        inverse = np.linalg.inv(homography)
        x, y = np.arange(CAMERA_PX), np.arange(CAMERA_PX)[:, None]
        cover[inverse[2, 0] * x + inverse[2, 1] * y + inverse[2, 2] <= 0] = 0


def clip_near(local: np.ndarray) -> np.ndarray:
    """Return the part of a convex polygon (N, 3) that lies before the near plane."""
    if local[:, 2].min() >= NEAR_m:
        return local
    kept = []
    for a, b in zip(local, np.roll(local, -1, axis=0), strict=True):
        if a[2] >= NEAR_m:
            kept.append(a)
        if (a[2] >= NEAR_m) != (b[2] >= NEAR_m):
            kept.append(a + (b - a) * (NEAR_m - a[2]) / (b[2] - a[2]))
    return np.array(kept).reshape(-1, 3)
