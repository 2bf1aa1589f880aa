"""Force on one pad: a field of its markers' motion, read by a small network per sensor type.

A field is (3, 8, 8): motion in x and y and growth on a fixed grid, whatever markers a sensor has.
Markers are found and matched as for the hand descriptor; each grid point takes the weighted mean of
the markers around it. Finger frame in, canonical frame out.

The network is trained in simulation on many units. It reads marker motion, not the tokenizer's
latents: on simulated grasps of unseen units its shear is off by less than 0.1 N, where heads on
latents are off by a sixth of the force. Its normal force depends on the shape of the object and is
corrected per grasp (see ``pair_judge``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import nn

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE, Finger, check_marker_image
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.markers.marker_blobs import spacing
from uniforce_vtla.tokenizer.descriptor import MIN_MATCHES, match, white_blobs
from uniforce_vtla.tokenizer.weights import load_model, read_config

GRID = 8
CHANNELS = 3
FEATURES = CHANNELS * GRID * GRID
# what counts as one: typical of a firm contact
MOTION_PX = 10.0
GROWTH = 0.2
ASSETS = Path(__file__).parent / "assets"
HIDDEN = (192, 96)


class TouchField:
    """Fields of one finger against its free-air reference.

    Args:
        reference: (480, 640) uint8 marker image in free air, as the sensor saw it.
        finger: which one; the right finger's field is mirrored into the canonical frame.

    Raises ContractError: no marker image, or too few markers.
    """

    def __init__(self, reference: np.ndarray, finger: Finger) -> None:
        self._mirrors = finger == "right"
        self._before = white_blobs(check_marker_image(reference, "reference"))
        if len(self._before.area_px) < MIN_MATCHES:
            came = len(self._before.area_px)
            raise ContractError(
                expected("reference", f"≥ {MIN_MATCHES} markers", came, "Capture it again.")
            )
        self._reach_px = spacing(self._before.centre_px)
        rows, columns = MARKER_IMAGE_SHAPE
        y = (np.arange(GRID) + 0.5) * rows / GRID
        x = (np.arange(GRID) + 0.5) * columns / GRID
        cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        distance = np.linalg.norm(cells[:, None] - self._before.centre_px[None], axis=-1)
        self._weight = np.exp(-0.5 * (distance / (0.7 * self._reach_px)) ** 2) + 1e-9  # (cells, M)

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Return (192,) float32 of one (480, 640) image: maps of motion x, motion y, growth."""
        after = white_blobs(check_marker_image(image))
        i, j = match(self._before, after, self._reach_px)
        field = np.zeros((GRID * GRID, CHANNELS), np.float32)
        if len(i) >= MIN_MATCHES:
            motion = (after.centre_px[j] - self._before.centre_px[i]) / MOTION_PX
            growth = np.log(after.area_px[j] / self._before.area_px[i]) / GROWTH
            weight = self._weight[:, i]
            values = weight @ np.column_stack([motion, growth])
            field[:] = values / np.maximum(weight.sum(axis=1, keepdims=True), 1e-6)
        maps: np.ndarray = field.T.reshape(CHANNELS, GRID, GRID)
        if self._mirrors:
            maps = maps[:, :, ::-1].copy()
            maps[0] *= -1  # motion in x
        return maps.ravel()


class FingerForce(nn.Module):
    """(N, 192) touch fields → (N, 3) newtons, canonical frame."""

    mean: torch.Tensor
    spread: torch.Tensor

    def __init__(self, dropout: float = 0.0) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(FEATURES))
        self.register_buffer("spread", torch.ones(FEATURES))
        first, second = HIDDEN
        self.layers = nn.Sequential(
            nn.Dropout(dropout), nn.Linear(FEATURES, first), nn.GELU(),
            nn.Linear(first, second), nn.GELU(), nn.Linear(second, 3),
        )  # fmt: skip

    def forward(self, field: torch.Tensor) -> torch.Tensor:
        """Return (N, 3) N of (N, 192) fields."""
        return self.layers((field - self.mean) / self.spread)

    @torch.no_grad()
    def read(self, field: np.ndarray) -> np.ndarray:
        """Return (N, 3) float64 N of (N, 192) fields."""
        return self(torch.from_numpy(np.asarray(field, np.float32))).double().numpy()

    @classmethod
    def from_pretrained(cls, sensor: str, folder: str | Path | None = None) -> FingerForce:
        """Load the reader of a sensor type, shipped or from a folder.

        Raises CheckpointError: none for that sensor, or damaged.
        """
        path = Path(folder or ASSETS / sensor)
        if not path.is_dir():
            known = " | ".join(sorted(p.name for p in ASSETS.glob("*") if p.is_dir()))
            do = "Train one: python -m benchmarks.pair_quality train=true rigs=…"
            raise CheckpointError(expected(f"force reader of {sensor}", known, "none", do))
        if (came := read_config(path).get("sensor")) != sensor:
            raise CheckpointError(
                expected(str(path), f"a reader of {sensor}", came, "Name another.")
            )
        return load_model(path, cls).eval()
