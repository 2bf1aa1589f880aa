"""TacTip pictures with depth and shear labels, as dexterousrobot/tactile_data_shear stores them.

A folder holds ``targets_images.csv``, ``processed_images/`` and the parameters of their processing:
binary pictures of the dome, cropped, masked by a circle. Its recordings have no licence: look at
them locally, never store them here.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.sensors import get_sensor

TARGETS, PICTURES, FREE_AIR = "targets_images.csv", "processed_images", "image_0.png"
DEPTH, SHEAR = "pose_z", ["shear_x", "shear_y"]
DOME_RADIUS_MM = 20.0  # what their circular mask shows


@dataclass(frozen=True)
class TactipSet:
    """One recording of one sensor, n frames."""

    name: str  # the robot's folder and the part of the recording
    reference: np.ndarray  # (480, 640) uint8
    reference_from: str  # "free air", or which contact stands in for it
    current: np.ndarray  # (n, 480, 640) uint8
    depth_mm: np.ndarray  # (n,) of the dome against the surface
    shear_mm: np.ndarray  # (n, 2) slid along the mount's x and y


def read_tactip_shear(folder: Path, frames: int) -> TactipSet:
    """Return evenly spaced ``frames``; DatasetError: a missing table, column, picture or parameter.

    Without a free-air picture the lightest contact with the least shear stands in for it.
    """
    if not (folder / TARGETS).is_file():
        raise DatasetError(expected(str(folder), TARGETS, "none", "Name the folder that holds it."))
    table = pd.read_csv(folder / TARGETS)
    if missing := {"sensor_image", DEPTH, *SHEAR} - set(table.columns):
        raise DatasetError(
            expected(
                f"columns of {folder / TARGETS}", "labels", f"no {sorted(missing)}", "Copy again."
            )
        )
    radius_px = _mask_radius_px(folder)
    chosen = table.iloc[np.linspace(0, len(table) - 1, min(frames, len(table))).astype(int)]
    free, came_from = folder / PICTURES / FREE_AIR, "free air"
    if not free.is_file():
        lightest = table.iloc[np.hypot(table[DEPTH], np.hypot(*table[SHEAR].to_numpy().T)).argmin()]
        free, came_from = (
            folder / PICTURES / lightest["sensor_image"],
            f"{lightest[DEPTH]:.2f} mm deep",
        )
    return TactipSet(
        "/".join(folder.resolve().parts[-3::2]),
        marker_image(free, radius_px),
        came_from,
        np.stack(
            [marker_image(folder / PICTURES / name, radius_px) for name in chosen["sensor_image"]]
        ),
        chosen[DEPTH].to_numpy(np.float64),
        chosen[SHEAR].to_numpy(np.float64),
    )


def marker_image(path: Path, radius_px: float) -> np.ndarray:
    """Return a picture as a (480, 640) uint8 marker image: the dome centred, at nominal scale."""
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise DatasetError(
            expected("picture", str(path), "none that can be read", "Copy the recording again.")
        )
    scale = get_sensor("tactip").px_per_mm[0] * DOME_RADIUS_MM / radius_px
    height, width = MARKER_IMAGE_SHAPE
    centre = (np.array(picture.shape[::-1]) - 1) / 2
    shift = (np.array([width, height]) - 1) / 2 - scale * centre
    moved = cv2.warpAffine(
        picture, np.array([[scale, 0, shift[0]], [0, scale, shift[1]]]), (width, height)
    )
    return np.where(moved >= 128, 255, 0).astype(np.uint8)


def _mask_radius_px(folder: Path) -> float:
    found = sorted(folder.glob("process*_image_params.json"))
    radius = read_object(found[0], DatasetError).get("circle_mask_radius") if found else None
    if not isinstance(radius, int | float):
        wanted = "circle_mask_radius in processed_image_params.json"
        raise DatasetError(expected(str(folder), wanted, "none", "Copy the recording again."))
    return float(radius)
