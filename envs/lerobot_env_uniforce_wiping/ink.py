"""Ink on the board, worn off by pressure and sliding, with uneven adhesion.

Archard's law above a threshold: felt pressed with less than F₀ glides over the ink, and more wears
it by F − F₀, as in Preston's equation with a threshold pressure. The threshold is the whole felt's:
its leading edge presses twice as hard as its middle, and alone would wipe at a light press.
"""

import cv2
import numpy as np

from lerobot_env_uniforce_wiping.scene_params import SceneParams

PIXEL_m = 0.001  # one ink cell
VISIBLE = 0.25  # a cell counts as residual ink above this
ADHESION_CELLS = 7  # blur of the adhesion noise, cells
STROKE_m = 0.005  # pen width


def _draw_word(word: str, rows: int, columns: int) -> np.ndarray:
    """Return (rows, columns) float32 in {0, 1}: the word filling the box."""
    font = cv2.FONT_HERSHEY_DUPLEX
    thickness = 3
    (width, height), base = cv2.getTextSize(word, font, 1.0, thickness)
    canvas = np.zeros((height + base + 6, width + 6), np.uint8)
    cv2.putText(canvas, word, (3, height + 3), font, 1.0, 255, thickness)
    r, c = np.nonzero(canvas)
    tight = canvas[r.min() : r.max() + 1, c.min() : c.max() + 1]
    word_box = cv2.resize(tight, (columns, rows), interpolation=cv2.INTER_AREA)
    return (word_box > 100).astype(np.float32)


class InkField:
    """Ink of one episode on a grid fixed to the board.

    Cell (i, j) lies at board x = (i + ½ − rows/2)·PIXEL_m and y = (j + ½ − columns/2)·PIXEL_m.
    """

    def __init__(self, scene: SceneParams) -> None:
        level = scene.level
        self.rows = 150  # cells along board x
        self.columns = 210  # cells along board y
        self.wear = level.wear_per_kPa_m
        self.wear_from_N = level.wear_from_N
        rng = np.random.default_rng([scene.seed, 711])
        noise = rng.standard_normal((self.rows, self.columns)).astype(np.float32)
        noise = cv2.GaussianBlur(noise, (0, 0), ADHESION_CELLS)
        self.adhesion = np.exp(level.adhesion_sigma * noise / noise.std())
        self._first = self._written(scene)
        self.ink = self._first.copy()
        self.version = 0  # grows whenever ink changes, so that renderers know
        self.initial_cells = float(np.count_nonzero(self.ink > VISIBLE))
        self._counted = 0
        self._residual = 1.0
        x = (np.arange(self.rows) + 0.5 - self.rows / 2) * PIXEL_m
        y = (np.arange(self.columns) + 0.5 - self.columns / 2) * PIXEL_m
        self.x_m, self.y_m = np.meshgrid(x, y, indexing="ij")

    def _written(self, scene: SceneParams) -> np.ndarray:
        level = scene.level
        rows = round(scene.letter_scale * level.letter_height_m / PIXEL_m)
        columns = round(scene.letter_scale * level.word_length_m / PIXEL_m)
        top = round(self.rows / 2 - rows / 2 + scene.word_offset_m[0] / PIXEL_m)
        left = round(self.columns / 2 - columns / 2 + scene.word_offset_m[1] / PIXEL_m)
        ink = np.zeros((self.rows, self.columns), np.float32)
        # Letters stand upright for the front camera: image up is board −x, image right is board +y.
        ink[top : top + rows, left : left + columns] = _draw_word(scene.word, rows, columns)
        return ink

    @property
    def residual(self) -> float:
        """Share of the initially inked cells that still carry visible ink."""
        if self._counted != self.version:
            self._residual = float(np.count_nonzero(self.ink > VISIBLE)) / self.initial_cells
            self._counted = self.version
        return self._residual

    @property
    def dirty_x_m(self) -> np.ndarray:
        """Board x of every cell that carries visible ink."""
        return self.x_m[self.ink > VISIBLE]

    @property
    def written_box_m(self) -> tuple[np.ndarray, np.ndarray]:
        """(2,) centre and (2,) extent of the first writing, board x and y."""
        inked = self._first > 0
        places_m = np.stack([self.x_m[inked], self.y_m[inked]])
        low = places_m.min(axis=1)
        high = places_m.max(axis=1)
        return (low + high) / 2, high - low

    def rewrite(self, center_m: np.ndarray, size_m: np.ndarray, strength: float) -> None:
        """Bring back the writing inside a box on the board, at ``strength`` of the first ink."""
        half_m = np.asarray(size_m) / 2
        inside = (np.abs(self.x_m - center_m[0]) <= half_m[0]) & (
            np.abs(self.y_m - center_m[1]) <= half_m[1]
        )
        self.ink = np.where(inside, np.maximum(self.ink, strength * self._first), self.ink)
        self.version += 1

    def wipe(
        self,
        center_m: np.ndarray,
        yaw_rad: float,
        size_m: np.ndarray,
        press: np.ndarray,
        slide_m: float,
    ) -> None:
        """Wear ink under a footprint.

        Args:
            center_m: (2,) centre of the felt in board coordinates.
            yaw_rad: rotation of the felt about the board's normal.
            size_m: (2,) felt extent along its own x and y.
            press: (3,) normal force N and the centre of pressure in the felt's frame, m.
            slide_m: sliding distance since the last call.
        """
        wearing_N = press[0] - self.wear_from_N
        if wearing_N <= 0 or slide_m <= 0:
            return
        reach = np.hypot(*size_m) / 2 + PIXEL_m
        rows = self._span(center_m[0], reach, self.rows)
        columns = self._span(center_m[1], reach, self.columns)
        if rows.start >= rows.stop or columns.start >= columns.stop:
            return
        c = np.cos(yaw_rad)
        s = np.sin(yaw_rad)
        dx = self.x_m[rows, columns] - center_m[0]
        dy = self.y_m[rows, columns] - center_m[1]
        # in felt halves of ±0.5
        u = (c * dx + s * dy) / size_m[0]
        v = (c * dy - s * dx) / size_m[1]
        inside = (np.abs(u) <= 0.5) & (np.abs(v) <= 0.5)
        # bilinear, right moment
        tilt = 1 + 12 * (press[1] / size_m[0] * u + press[2] / size_m[1] * v)
        wearing_kPa = wearing_N / (size_m[0] * size_m[1]) / 1000 * np.maximum(tilt, 0) * inside
        worn = np.exp(-self.wear * wearing_kPa * slide_m / self.adhesion[rows, columns])
        self.ink[rows, columns] *= worn
        self.version += 1

    @staticmethod
    def _span(center_m: float, reach_m: float, cells: int) -> slice:
        start = int(np.floor((center_m - reach_m) / PIXEL_m + cells / 2))
        stop = int(np.ceil((center_m + reach_m) / PIXEL_m + cells / 2))
        return slice(max(start, 0), min(stop, cells))
