"""Estimate the ink left on a real board from a camera's first and last picture.

Four corners of the board give a homography to a top view. Ink of the first picture is looked up in
the last one. Cells hidden by the arm or the eraser are left out, not guessed, and the estimate says
how many it could judge.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from uniforce_vtla.errors import ContractError, DatasetError, expected

# rows, columns of the board seen from above: 1 mm cells of the simulated board
TOP_VIEW_px = (170, 230)
RIM_share = 0.04  # of the board left out along its edges: blur and shadow
INK_CONTRAST = 0.35  # a cell darker than the bare board by this share of its brightness is ink
FADED = 0.25  # of its first strength: fainter is no ink, as in the simulator's own count
# distance of a colour from the line bare → ink, over the bare brightness; beyond it is neither
ALIKE = 0.15
SMALLEST_WORD = 40  # cells; fewer are noise
LEAST_JUDGED = 0.5  # of the first picture's ink; with less in view there is no estimate


@dataclass(frozen=True)
class ResidualEstimate:
    """Ink left on a board."""

    residual: float  # over ink at the start, among the cells that could be judged
    judged: float  # share of those cells


def estimate_residual(
    first: np.ndarray, last: np.ndarray, corners_px: np.ndarray
) -> ResidualEstimate:
    """Estimate the ink left between two pictures of one camera.

    Args:
        first: (H, W, 3) uint8 RGB before the wipe, the writing in view.
        last: the same camera after it.
        corners_px: (4, 2) image points x, y of the board's corners, in order around it.

    Raises ContractError: pictures of different shape, or corners that are no quadrilateral;
    DatasetError: no writing in the first picture, or too little of it in view in the last.
    """
    _check(first, last, corners_px)
    before = _top_view(first, corners_px)
    after = _top_view(last, corners_px)
    bare = np.median(before.reshape(-1, 3), axis=0)  # most of a board is bare
    brightness = float(bare.mean())
    ink = brightness - before.mean(axis=-1) > INK_CONTRAST * brightness
    if ink.sum() < SMALLEST_WORD:
        do = "Take the first picture before the wipe, the arm out of the way; check the corners."
        raise DatasetError(expected("writing on the board", "dark cells", int(ink.sum()), do))
    # strokes are thin: most cells are mixed with board
    ink_colour = np.percentile(before[ink], 25, axis=0)
    strength, _ = _on_the_way(before, bare, ink_colour)
    now_bare = np.median(after[~ink], axis=0)  # light may have changed
    now, off_the_way = _on_the_way(after, now_bare, ink_colour)
    judgeable = off_the_way < ALIKE * brightness
    seen = ink & judgeable
    judged = float(seen.sum() / ink.sum())
    if judged < LEAST_JUDGED:
        do = "Move the arm away before the last picture."
        raise DatasetError(
            expected("writing in view", f"≥ {LEAST_JUDGED:.0%}", f"{judged:.0%}", do)
        )
    left = seen & (now > FADED * strength)
    return ResidualEstimate(float(left.sum() / seen.sum()), judged)


def _on_the_way(
    view: np.ndarray, bare: np.ndarray, ink: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how far each cell's colour lies from bare (0) to ink (1), and off that line."""
    way = ink - bare
    share = np.clip((view - bare) @ way / (way @ way), 0, 1)
    return share, np.linalg.norm(view - bare - share[..., None] * way, axis=-1)


def _check(first: np.ndarray, last: np.ndarray, corners_px: np.ndarray) -> None:
    if first.shape != last.shape or first.ndim != 3 or first.shape[2] != 3:
        raise ContractError(
            expected("pictures", "two (H, W, 3)", f"{first.shape}, {last.shape}", "Use one camera.")
        )
    corners = corners_px.astype(np.float32)
    if (
        corners.shape != (4, 2)
        or abs(cv2.contourArea(corners)) < 100
        or not cv2.isContourConvex(corners)
    ):
        do = "Name the board's corners in order around it."
        raise ContractError(
            expected("corners_px", "(4, 2), a convex quadrilateral", corners_px.tolist(), do)
        )


def _top_view(image: np.ndarray, corners_px: np.ndarray) -> np.ndarray:
    """Return the board from above without its rim, (rows, columns, 3) float32."""
    rows, columns = TOP_VIEW_px
    target = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], np.float32)
    homography = cv2.getPerspectiveTransform(corners_px.astype(np.float32), target)
    view = cv2.warpPerspective(image, homography, (columns, rows), flags=cv2.INTER_LINEAR)
    r = round(RIM_share * rows)
    c = round(RIM_share * columns)
    return view[r : rows - r, c : columns - c].astype(np.float32)
