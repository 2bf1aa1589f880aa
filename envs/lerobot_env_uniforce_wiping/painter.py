"""Camera pictures without GL: primitives projected and painted far to near with OpenCV.

Flat shaded, deterministic on every machine. Table, board and ink come first, the rest by distance.
"""

import cv2
import mujoco
import numpy as np

from lerobot_env_uniforce_wiping.cameras import (
    Camera,
    carried,
    front_camera,
    rotation,
    wrist_camera,
)
from lerobot_env_uniforce_wiping.ink import PIXEL_m
from lerobot_env_uniforce_wiping.levels import CAMERA_PX
from lerobot_env_uniforce_wiping.simulation import WipeSimulation

BACKGROUND = np.array([206.0, 212.0, 218.0])  # RGB under plain light
# direction towards the light, world frame, unless a scene turns it
LIGHT = np.array([0.45, 0.25, 0.86])
ROUND_NORMAL = np.array([0.6, 0.0, 0.8])  # capsules are shaded flat, as if facing this way
AMBIENT = 0.62
NEAR_m = 0.012  # nothing closer is painted
SUBPIXEL = 4  # fractional bits of polygon corners
FAR_px = 4000  # corners further out are clamped: fixed-point numbers stay small
_TURNS = np.linspace(0, 2 * np.pi, 16, endpoint=False)
RING = np.stack([np.cos(_TURNS), np.sin(_TURNS), np.zeros(16)], axis=-1)
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
FACES = np.array(
    [(4, 6, 7, 5), (0, 1, 3, 2), (2, 3, 7, 6), (0, 4, 5, 1), (1, 5, 7, 3), (0, 2, 6, 4)]
)
NORMALS = np.array(
    [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=float
)
HIDDEN_GROUP = 4  # collision pads: what is drawn is the same skin for every sensor
INK_COLOUR = np.array([30, 30, 120], dtype=np.float32)
MARGIN = 1  # clear cells around the writing


class Painter:
    """Paints the two cameras of a scene."""

    def reset(self, sim: WipeSimulation) -> None:
        """Start painting a new scene."""
        model = sim.model
        self._data = sim.data
        self._hand = model.body("hand").id
        self._front = front_camera(sim.scene)
        self._wrist = wrist_camera(sim.scene)
        gain = np.array(sim.scene.light_gain)
        self._light = rotation(sim.scene.light_turn_rad) @ LIGHT
        self._background = np.full(
            (CAMERA_PX, CAMERA_PX, 3), np.minimum(BACKGROUND * gain, 255), np.uint8
        )
        self._ink = InkView(sim)
        shown = np.flatnonzero(model.geom_group != HIDDEN_GROUP)
        is_box = model.geom_type[shown] == mujoco.mjtGeom.mjGEOM_BOX
        self._boxes = shown[is_box]
        self._rounds = shown[~is_box]
        self._corners = CORNERS * model.geom_size[self._boxes][:, None]  # (boxes, 8, 3)
        self._radius, self._half = model.geom_size[self._rounds][:, :2].T
        self._colours = model.geom_rgba[:, :3].astype(np.float64) * 255 * gain
        ground = {model.geom("table").id: 2, model.geom("board").id: 1}
        self._layer = np.array([ground.get(int(g), 0) for g in (*self._boxes, *self._rounds)])

    def render(self) -> list[np.ndarray]:
        """Return the front and wrist pictures, (224, 224, 3) uint8 RGB each."""
        body = self._data.xpos[self._hand]
        axes = self._data.xmat[self._hand].reshape(3, 3)
        return [self._paint(self._front), self._paint(carried(self._wrist, body, axes))]

    def _paint(self, camera: Camera) -> np.ndarray:
        picture = self._background.copy()
        polygons = [*self._box_polygons(camera), *self._round_polygons(camera)]
        centers = self._data.geom_xpos[np.concatenate([self._boxes, self._rounds])]
        # ground first
        away = np.linalg.norm(centers - camera.position_m, axis=1) + 100.0 * self._layer
        inked = False
        for index in np.argsort(-away):
            if not inked and self._layer[index] == 0:
                self._ink.paint(picture, camera)
                inked = True
            for corners, colour in polygons[index]:
                cv2.fillConvexPoly(picture, corners, colour, cv2.LINE_AA, SUBPIXEL)
        return picture

    def _brightness(self, normals: np.ndarray) -> np.ndarray:
        return AMBIENT + (1 - AMBIENT) * np.maximum(normals @ self._light, 0)

    def _box_polygons(self, camera: Camera) -> list[list[tuple[np.ndarray, tuple[float, ...]]]]:
        """Return the faces turned towards the camera, by box."""
        axes = self._data.geom_xmat[self._boxes].reshape(-1, 3, 3)
        centers = self._data.geom_xpos[self._boxes]
        corners = centers[:, None] + self._corners @ axes.transpose(0, 2, 1)  # (boxes, 8, 3)
        normals = NORMALS @ axes.transpose(0, 2, 1)  # (boxes, 6, 3)
        towards = corners[:, FACES[:, 0]] - camera.position_m
        seen = (normals * towards).sum(-1) < 0
        bright = self._brightness(normals)
        local = camera.to_camera(corners.reshape(-1, 3)).reshape(corners.shape)
        pixels = _fixed(camera.to_pixels(_before(local)))  # (boxes, 8, 2)
        near = local[..., 2].min(axis=1) < NEAR_m
        polygons = []
        for b, geom in enumerate(self._boxes):
            faces = []
            for f in np.flatnonzero(seen[b]):
                shape = _clipped(camera, local[b, FACES[f]]) if near[b] else pixels[b, FACES[f]]
                faces.append((shape, tuple(self._colours[geom] * bright[b, f])))
            polygons.append([face for face in faces if len(face[0]) >= 3])
        return polygons

    def _round_polygons(self, camera: Camera) -> list[list[tuple[np.ndarray, tuple[float, ...]]]]:
        """Return the hull of both end discs, by capsule."""
        axes = self._data.geom_xmat[self._rounds].reshape(-1, 3, 3)[:, :, 2] * self._half[:, None]
        centers = self._data.geom_xpos[self._rounds]
        ends = np.stack([centers + axes, centers - axes], axis=1)  # (rounds, 2, 3)
        local = camera.to_camera(ends.reshape(-1, 3)).reshape(ends.shape)
        rings = local[:, :, None] + RING * self._radius[:, None, None, None]
        pixels = _fixed(camera.to_pixels(_before(rings))).reshape(len(ends), -1, 2)
        seen = local[..., 2].min(axis=1) > self._radius + NEAR_m
        bright = float(self._brightness(ROUND_NORMAL))
        return [
            [(cv2.convexHull(pixels[i]), tuple(self._colours[geom] * bright))] if seen[i] else []
            for i, geom in enumerate(self._rounds)
        ]


def _before(local: np.ndarray) -> np.ndarray:
    """Keep depths positive, so that nothing divides by zero."""
    safe = local.copy()
    safe[..., 2] = np.maximum(safe[..., 2], NEAR_m)
    return safe


def _fixed(pixels: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(pixels, -FAR_px, FAR_px) * (1 << SUBPIXEL)).astype(np.int32)


def _clipped(camera: Camera, local: np.ndarray) -> np.ndarray:
    """Return fixed-point pixels of the part of a convex polygon (N, 3) before the near plane."""
    kept = []
    for a, b in zip(local, np.roll(local, -1, axis=0), strict=True):
        if a[2] >= NEAR_m:
            kept.append(a)
        if (a[2] >= NEAR_m) != (b[2] >= NEAR_m):
            kept.append(a + (b - a) * (NEAR_m - a[2]) / (b[2] - a[2]))
    return _fixed(camera.to_pixels(np.array(kept).reshape(-1, 3)))


class InkView:
    """Paints the current ink of a scene; warps only the part of the board that was written on."""

    def __init__(self, sim: WipeSimulation) -> None:
        self._ink = sim.ink
        self._data = sim.data
        self._board = sim.model.body("board").id
        rows, columns = np.nonzero(sim.ink.ink)
        self._rows = slice(rows.min() - MARGIN, rows.max() + 1 + MARGIN)
        self._columns = slice(columns.min() - MARGIN, columns.max() + 1 + MARGIN)
        x0 = (self._rows.start + 0.5 - sim.ink.rows / 2) * PIXEL_m
        y0 = (self._columns.start + 0.5 - sim.ink.columns / 2) * PIXEL_m
        # (column, row, 1) → board
        self._to_board = np.array([[0, PIXEL_m, x0], [PIXEL_m, 0, y0], [0, 0, 0]])
        self._colour = np.minimum(
            INK_COLOUR * np.array(sim.scene.light_gain, dtype=np.float32), 255
        )
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
        corners = (
            np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]]) @ homography.T
        )
        # partly behind the camera: the hand is over the tray, nothing to see
        if corners[:, 2].min() <= 0:
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
