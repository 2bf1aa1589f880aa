"""Free-air references.

Taken from several frames, refused where they can be known to be in contact, remembered.

These checks find a touch that moves or changes within the frames, a tared taxel that was pressed at
the reference (it reads negative once released), and taxels far from a stored resting level. They
can't find a steady touch on a gel seen by a camera, or on taxels without a stored resting level: it
looks like free air.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from uniforce_vtla.errors import ContractError, SensorError, expected
from uniforce_vtla.markers.marker_blobs import spacing
from uniforce_vtla.markers.marker_hold import MISSED
from uniforce_vtla.markers.taxel_render import check_alive, check_counts

if TYPE_CHECKING:
    import torch


# when a reference counts as touched
MIN_FRAMES = 3  # fewer can't show motion
MAX_TAXEL_STD = 15.0  # counts, from the median deviation; real sensors at rest: 1.1–5
MAX_REST_OFFSET = 150.0  # counts from the stored resting level; a light touch gives 300
MAX_MARKER_MOTION_PX = 2.0  # 90th percentile over markers; segmentation jitter stays below 0.5
PRESSED_COUNTS = 300.0  # a taxel this far *below* its reference was pressed then
# so many of 16: one alone may be cross-talk (0.4 % of real taxels read below −30)
PRESSED_TAXELS = 4


def capture_taxel_reference(
    scans: Sequence[np.ndarray], resting_level: np.ndarray | None = None
) -> np.ndarray:
    """Return the (16, 3) int64 median of several free-air scans of a uSkin's (16, 3) counts.

    Args:
        scans: consecutive raw scans, at least three.
        resting_level: (16, 3) counts known to be free air, if any; without it a steady touch can't
            be seen.

    Raises ContractError: too few scans, or one that isn't (16, 3) integers; SensorError: dead,
    moving between scans, or far from the resting level.
    """
    _check_enough(len(scans))
    # (N, 16, 3)
    counts = np.stack([check_counts(np.asarray(scan), "uSkin reference") for scan in scans])
    for scan in counts:
        check_alive(scan, "uSkin reference")
    reference = np.rint(capture_row_reference(counts, MAX_TAXEL_STD)).astype(np.int64)
    if resting_level is not None:
        resting = check_counts(np.asarray(resting_level), "resting level")
        offset = int(np.abs(reference - resting).max())
        if offset > MAX_REST_OFFSET:
            refuse(
                f"taxels within {MAX_REST_OFFSET:g} counts of the resting level",
                f"{offset} counts off",
            )
    return reference


def capture_row_reference(rows: Sequence[np.ndarray] | np.ndarray, most: float) -> np.ndarray:
    """Return the (M, 3) median of several free-air readings (M, 3) of taxels or points.

    ``most`` is the largest standard deviation of a number that holds still, in its own unit.

    Raises ContractError: too few; SensorError: moving between them.
    """
    _check_enough(len(rows))
    median = np.median(rows, axis=0)
    spread = np.median(np.abs(np.asarray(rows) - median), axis=0)
    moved = float(1.4826 * spread.max())  # one garbled reading isn't a touch
    if moved > most:
        refuse(f"numbers steady within {most:g}", f"a spread of {moved:.2g}")
    return median


def capture_camera_reference(
    frames: Sequence[np.ndarray], centres_px: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the pixel-wise median of several (H, W, 3) uint8 frames whose markers hold still.

    Args:
        frames: consecutive camera frames of one size.
        centres_px: their marker centres, from ``Canonicalizer.markers``.

    Raises ContractError: too few frames, or of different sizes; SensorError: markers move between
    the frames.
    """
    _check_enough(min(len(frames), len(centres_px)))
    if len({frame.shape for frame in frames}) > 1:
        raise ContractError(
            expected("reference frames", "one size", "several", "Use one camera setting.")
        )
    reach_px = MISSED * spacing(centres_px[0])  # beyond it a marker was missed, which is no motion
    nearest_px = [cKDTree(centres).query(centres_px[0])[0] for centres in centres_px[1:]]
    motion_px = 0.0
    for distance_px in nearest_px:
        again_px = distance_px[distance_px < reach_px]
        moved_px = float(np.percentile(again_px, 90)) if len(again_px) else reach_px
        motion_px = max(motion_px, moved_px)
    if motion_px > MAX_MARKER_MOTION_PX:
        wanted = f"markers still within {MAX_MARKER_MOTION_PX:g} px"
        refuse(wanted, f"a motion of {motion_px:.1f} px")
    return np.median(np.stack(frames), axis=0).astype(np.uint8)


def refuse_pressed_reference(delta_counts: np.ndarray) -> None:
    """Raise SensorError where (M, 3) uSkin counts show that the reference was pressed."""
    released = int((delta_counts[:, 2] < -PRESSED_COUNTS).sum())
    if released >= PRESSED_TAXELS and delta_counts[:, 2].sum() < 0:
        refuse("taxels at or above it", f"{released} of {len(delta_counts)} far below it")


def _check_enough(count: int) -> None:
    if count < MIN_FRAMES:
        wanted = f"at least {MIN_FRAMES} frames"
        raise ContractError(
            expected("reference", wanted, count, "Record a little longer in free air.")
        )


def refuse(wanted: str, came: str) -> None:
    """Raise SensorError: a reference was taken in contact."""
    do = "It was in contact: open the gripper and take it again in free air."
    raise SensorError(expected("reference", wanted, came, do))


class ReferenceMemory[Value]:
    """Cache of values computed from the latest references.

    A stream pairs every frame with the same one.

    Args:
        most: references remembered; the oldest is forgotten.
    """

    def __init__(self, most: int) -> None:
        self._known: deque[tuple[Hashable, np.ndarray | torch.Tensor, Value]] = deque(maxlen=most)

    def get(
        self, key: Hashable, reference: np.ndarray | torch.Tensor, compute: Callable[[], Value]
    ) -> Value:
        """Return the value of a reference: remembered for its key and content, or computed."""
        for known_key, known, value in tuple(self._known):  # another thread may add one
            if known_key == key and same_reference(known, reference):
                return value
        value = compute()
        copy = reference.copy() if isinstance(reference, np.ndarray) else reference.clone()
        self._known.append((key, copy, value))
        return value

    def forget(self) -> None:
        """Forget all references: another episode begins."""
        self._known.clear()


def same_reference(first: np.ndarray | torch.Tensor, second: np.ndarray | torch.Tensor) -> bool:
    """Return whether two references (numpy or torch) have the same type, shape and content.

    NaN equals nothing.
    """
    alike = (
        type(first) is type(second) and first.dtype == second.dtype and first.shape == second.shape
    )
    if not alike or first.device != second.device:
        return False
    return bool((first == second).all())
