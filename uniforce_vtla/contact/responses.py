"""Response of a unit's markers and taxels to traction, from the finite elements."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from uniforce_vtla.contact.elastic import Influence
from uniforce_vtla.contact.raw_look import PixelNoise
from uniforce_vtla.contact.traction import Traction
from uniforce_vtla.sensors.material import ForceTaxelMaterial, PadMaterial, TaxelMaterial


@dataclass(frozen=True)
class ContactOptions:
    """Friction and randomness of a simulated unit."""

    # Coulomb coefficient of pad against object; rubber on wood or plastic, .8–1.2
    friction: float = 1.0
    noise: bool = True  # per-marker position noise (camera) or count noise (taxel)
    # standard deviation of a marker's found centre, in pixels of the canonical image
    noise_px: float = 0.3
    noise_counts: float = 1.8  # raw standard deviation of real uSkins at rest is 1.1–2.6 counts
    # drop single camera markers at random; off: the paper's layouts are complete
    marker_loss: bool = False
    # per marker and frame (the ViTac 2024 simulation track uses the same)
    loss_probability: float = 0.01
    # of raw frames: anew for every pixel, or from a "sheet", 11 ms a frame faster
    pixel_noise: PixelNoise = "drawn"

    def quiet(self) -> ContactOptions:
        """Return these options without randomness."""
        return replace(self, noise=False, marker_loss=False)


@dataclass(frozen=True)
class MarkerMotion:
    """Motion of M markers in the camera's view."""

    shift_mm: np.ndarray  # (B, M, 2)
    growth: np.ndarray  # (B, M) factor on their size

    def without(self, still: np.ndarray) -> MarkerMotion:
        """Return this motion but for the (M,) bool markers that stand still."""
        if not still.any():
            return self
        return MarkerMotion(
            np.where(still[:, None], 0, self.shift_mm), np.where(still, 1, self.growth)
        )


class PointMotion:
    """Displacement of points at the readout depth and its gradient; linear in traction."""

    def __init__(
        self, influence: Influence, point_mm: np.ndarray, scale: float, reach_mm: float = 0.0
    ) -> None:
        """Take (M, 2) points; with a reach each moves as the mean of what lies within it."""
        ring: np.ndarray = np.zeros((1, 1, 2))
        if reach_mm:
            ways = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
            ring = reach_mm / 2**0.5 * ways[:, None]  # (4, 1, 2)
        around = (point_mm + ring).reshape(-1, 2)
        at = _interpolated(influence.fields, influence.x_mm, influence.y_mm, around)  # (M, F, 3, C)
        at = at.reshape(len(ring), len(point_mm), *at.shape[1:]).mean(axis=0)
        by_cell = (at * np.float32(scale)).transpose(3, 2, 1, 0)  # (C, 3, F, M)
        self._of_shear = np.ascontiguousarray(by_cell[:, :2])
        self._of_press = np.ascontiguousarray(by_cell[:, 2])

    def __call__(self, traction: Traction) -> np.ndarray:
        """Return (B, F, M): the six of ``Influence.fields``."""
        B = len(traction.press_N)
        _, F, M = self._of_press.shape
        shear = traction.shear_N.transpose(0, 2, 1).reshape(B, -1)
        motion = traction.press_N @ self._of_press[traction.cells].reshape(-1, F * M)
        return (motion + shear @ self._of_shear[traction.cells].reshape(-1, F * M)).reshape(B, F, M)


def _interpolated(
    field: np.ndarray, x_mm: np.ndarray, y_mm: np.ndarray, point_mm: np.ndarray
) -> np.ndarray:
    """Return (M, …) of a (rows, columns, …) field at (M, 2) points, bilinearly, clamped to it."""
    i, tx = _place(x_mm, point_mm[:, 0])
    j, ty = _place(y_mm, point_mm[:, 1])
    corners = (j * len(x_mm) + i)[:, None] + np.array([0, 1, len(x_mm), len(x_mm) + 1])
    weights = np.stack([(1 - ty) * (1 - tx), (1 - ty) * tx, ty * (1 - tx), ty * tx], axis=1)
    rows = np.repeat(np.arange(len(point_mm)), 4)
    nodes = len(x_mm) * len(y_mm)
    mix = csr_array(
        (weights.ravel().astype(np.float32), (rows, corners.ravel())), (len(point_mm), nodes)
    )
    return (mix @ field.reshape(nodes, -1)).reshape(len(point_mm), *field.shape[2:])


def _place(edges: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which interval of ``edges`` each value is in, and how far into it, 0–1."""
    value = np.clip(value, edges[0], edges[-1])
    index = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)
    return index, (value - edges[index]) / (edges[index + 1] - edges[index])


class CameraResponse:
    """Markers of one unit as its camera sees them."""

    def __init__(
        self, influence: Influence, rest_mm: np.ndarray, material: PadMaterial, scale: float = 1.0
    ) -> None:
        self._rest_mm = rest_mm
        self._material = material
        self._motion = PointMotion(influence, rest_mm, scale)

    def __call__(self, traction: Traction) -> MarkerMotion:
        """Return the motion of all markers under a batch of tractions."""
        m = self._material
        field = self._motion(traction)
        shift = field[:, :2] - m.pin_mm * field[:, 4:]  # a pin tilts with the skin that holds it
        # (B, M): what is pressed towards the camera looks larger
        nearer = field[:, 2] / m.camera_mm
        shift = shift.transpose(0, 2, 1) + self._rest_mm * nearer[..., None]
        return MarkerMotion(shift, np.sqrt(np.clip(1 + field[:, 3], 0.25, 4.0)) * (1 + nearer))


class PointResponse:
    """Points that the sensor tracks itself: their displacements in mm, z into the pad."""

    def __init__(self, influence: Influence, rest_mm: np.ndarray, scale: float = 1.0) -> None:
        self._motion = PointMotion(influence, rest_mm, scale)

    def __call__(self, traction: Traction) -> np.ndarray:
        """Return (B, N, 3) float32 displacements in mm, without noise."""
        return self._motion(traction)[:, :3].transpose(0, 2, 1).astype(np.float32)


class TaxelResponse:
    """Magnets in the elastomer over Hall sensors: each magnet changes the field of every sensor.

    Dipoles along z. Image x → count x, image y (down) → minus count y.
    """

    def __init__(
        self,
        influence: Influence,
        taxel_mm: np.ndarray,
        material: TaxelMaterial,
        gain: np.ndarray,
        scale: float = 1.0,
    ) -> None:
        self._motion = PointMotion(influence, taxel_mm, scale, material.magnet_mm / 2)
        # (sensor, magnet, 2)
        self._apart_mm = (taxel_mm[None] - taxel_mm[:, None]).astype(np.float32)
        self._material = material
        self._rest = self._field(np.zeros((1, 3, len(taxel_mm)), np.float32))
        self._gain = gain.astype(np.float32)  # (M, 3)

    def __call__(self, traction: Traction) -> np.ndarray:
        """Return (B, M, 3) float32 counts above the baseline, without noise."""
        change = self._field(self._motion(traction)) - self._rest
        return change * np.array([1, -1, 1], np.float32) * self._gain

    def _field(self, moved_mm: np.ndarray) -> np.ndarray:
        """Return (B, M, 3) counts at the sensors, given (B, ≥ 3, M) displacements of magnets."""
        m = self._material
        # (B, sensor, magnet, 2)
        aside = self._apart_mm + moved_mm[:, :2].transpose(0, 2, 1)[:, None]
        # it can't reach the board
        over = np.maximum(m.hall_mm - moved_mm[:, 2], 0.2 * m.hall_mm)[:, None, :, None]
        r2 = (aside**2).sum(axis=-1, keepdims=True) + over**2
        along = 3 * over**2 / r2 - 1  # dipole: 3 (m·r) r / r⁵ − m / r³
        field = np.concatenate([3 * over * aside / r2, along], axis=-1) / r2**1.5
        return (field.sum(axis=2) * (0.5 * m.rest_counts * m.hall_mm**3)).astype(np.float32)


class ForceTaxelResponse:
    """Taxels that measure newtons: the forces on the skin are shared out among those nearby."""

    def __init__(
        self, skin_mm: np.ndarray, taxel_mm: np.ndarray, made: ForceTaxelMaterial, gain: np.ndarray
    ) -> None:
        """Take the skin's cells (C, 2), the taxels (M, 2) and each one's gain (M, 3)."""
        apart_mm = np.linalg.norm(skin_mm[:, None] - taxel_mm, axis=-1)  # (C, M)
        # from the nearest one's on, so that no cell is too far from all
        nearest_mm = apart_mm.min(axis=1, keepdims=True)
        share = np.exp((nearest_mm**2 - apart_mm**2) / (2 * made.spread_mm**2))
        self._share = (share / share.sum(axis=1, keepdims=True)).astype(np.float32)
        y_up = np.array([1, -1, 1], np.float32)
        self._gain = gain.astype(np.float32) * y_up / np.float32(made.count_N)

    def __call__(self, traction: Traction) -> np.ndarray:
        """Return (B, M, 3) float32 counts, without noise; count y points up."""
        # (B, 3, cells)
        force_N = np.concatenate([traction.shear_N, traction.press_N[:, None]], axis=1)
        return (force_N @ self._share[traction.cells]).transpose(0, 2, 1) * self._gain
