"""A simulated sensor: contact state in, marker images, raw frames or counts out, in batches."""

from collections.abc import Callable

import numpy as np

from uniforce_vtla.contact.pads import CELL_MM, GRID_CELLS, build_pad, has_object
from uniforce_vtla.contact.pressure import Pressure, solve_pressure
from uniforce_vtla.contact.raw_look import gelsight_frames, tactip_frames
from uniforce_vtla.contact.responses import (
    CameraResponse,
    ContactOptions,
    ForceTaxelResponse,
    PointResponse,
    TaxelResponse,
)
from uniforce_vtla.contact.traction import CellSkin, Traction, solve_traction, transmitted
from uniforce_vtla.contact.units import Look, UnitVariation
from uniforce_vtla.contact.virtual import VirtualSensor, as_virtual, gel_of
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.markers.point_render import place_points
from uniforce_vtla.markers.raster import CENTRE_PX, fill_discs, fill_squares
from uniforce_vtla.markers.taxel_render import TaxelDiscs, TaxelScales, draw_discs, place_discs
from uniforce_vtla.sensors.layouts import turned
from uniforce_vtla.sensors.material import ForceTaxelMaterial, TaxelMaterial

Transform = Callable[[np.ndarray], np.ndarray]  # (B, 480, 640) uint8 → (B, …), e.g. an area resize

Taxels = TaxelResponse | ForceTaxelResponse
# there is no camera: the canonicalizer draws their rows of three numbers
Drawn = Taxels | PointResponse
_CHUNK = 16  # images drawn at once: 5 MB, stays in cache
_SCALES = TaxelScales()


class TactileSimulator:
    """One unit of a sensor. Same seed and same calls, same output.

    Args:
        sensor: registry name, or a virtual sensor.
        unit: how this unit differs from the drawing; None for the drawing itself.
        options: friction and randomness.
        seed: draws the noise.
    """

    def __init__(
        self,
        sensor: str | VirtualSensor,
        unit: UnitVariation | None = None,
        options: ContactOptions | None = None,
        seed: int = 0,
    ) -> None:
        drawing = as_virtual(sensor)
        self.spec = drawing.spec
        self.unit = unit or UnitVariation()
        self.options = options or ContactOptions()
        self._rng = np.random.default_rng(seed)
        self._material = drawing.material
        self.pad = build_pad(gel_of(self.spec, self._material))
        self._stiffness = self._material.stiffness * self.unit.stiffness
        self._respond = self._build_response()
        self._lost, self._dead = self._damage()
        self._pressed = np.zeros(0, int)
        self._skin = CellSkin.of(self.pad.influence.skin, self._pressed)

    def reference(self) -> np.ndarray:
        """Return the (480, 640) uint8 marker image in free air, without noise."""
        return self._images(self.traction(free_air(1)), noise=False)[0]

    def marker_images(self, contact: ContactState) -> np.ndarray:
        """Return (B, 480, 640) uint8 marker images in {0, 255}, in this sensor's own frame."""
        return self.images_under(self.traction(contact))

    def images_under(self, traction: Traction) -> np.ndarray:
        """Return the marker images of given forces on the pad's cells, instead of a contact's."""
        return self._images(traction, self.options.noise)

    def markers_px(self, contact: ContactState) -> tuple[np.ndarray, np.ndarray]:
        """Return marker centres (B, M, 2) in pixels x, y and sizes (B, M): sides or diameters.

        A lost marker's centre is NaN.
        """
        return self._markers(self.traction(contact), self.options.noise)

    def faces_object(self, contact: ContactState) -> np.ndarray:
        """Return (B,) bool: whether any part of the pad has an object before it."""
        return has_object(self.pad.total_gap_mm(contact.gap_mm))

    def depth_mm(self, contact: ContactState) -> np.ndarray:
        """Return (B,) indentation since first touch, in mm."""
        return self._pressure(contact).depth_mm

    def carried(self, contact: ContactState) -> tuple[np.ndarray, np.ndarray]:
        """Return force (B, 3) N and torsion (B,) Nmm the pad carries: less where it slips."""
        traction = self.traction(contact)
        return transmitted(traction.press_N, traction.shear_N, self.pad.position_mm[traction.cells])

    def counts(self, contact: ContactState) -> np.ndarray:
        """Return (B, M, 3) float32 counts above the baseline, in the sensor's own unit.

        Raises ContractError: the sensor is a camera.
        """
        if not isinstance(self._respond, Taxels):
            raise ContractError(
                expected("counts", "a taxel sensor", self.spec.name, "Use raw_frames for a camera.")
            )
        return self._rows(self.traction(contact), self.options.noise)

    def raw_reference(self) -> np.ndarray:
        """Return a raw signal in free air, see ``raw_frames``, without the batch axis."""
        return self.raw_frames(free_air(1))[0]

    def raw_frames(self, contact: ContactState) -> np.ndarray:
        """Return (B, 480, 640, 3) uint8 RGB frames, (B, M, 3) int32 counts or (B, N, 3) mm."""
        if isinstance(self._respond, Drawn):
            rows = self._rows(self.traction(contact), self.options.noise)
            if self.spec.points:
                return rows
            return (self._baseline + rows).astype(np.int32)
        press_N = self._pressure(contact).press_N  # solved once for picture and shade
        images = self.images_under(self._traction(press_N, contact))
        if self.spec.dome_radius_mm is not None:
            return tactip_frames(images, self._rng, self.options.pixel_noise)
        return gelsight_frames(
            images,
            self._indentation_mm(press_N),
            CELL_MM,
            self.spec.px_per_mm[0],
            self._rng,
            self.options.pixel_noise,
        )

    def _pressure(self, contact: ContactState) -> Pressure:
        return solve_pressure(self.pad, contact.gap_mm, contact.force_N[:, 2], self._stiffness)

    def _indentation_mm(self, press_N: np.ndarray) -> np.ndarray:
        """Return (B, G, G) inward displacement of the skin by pressure."""
        depth = np.zeros((len(press_N), GRID_CELLS**2), dtype=np.float32)
        moved = press_N @ self.pad.normal / self._stiffness
        depth[:, self.pad.block] = moved[..., None]
        return depth.reshape(-1, GRID_CELLS, GRID_CELLS)

    def traction(self, contact: ContactState) -> Traction:
        """Return the forces on the pad's cells."""
        return self._traction(self._pressure(contact).press_N, contact)

    def _traction(self, press: np.ndarray, contact: ContactState) -> Traction:
        cells = np.flatnonzero(press.any(axis=0))  # most contacts press few
        press = press[:, cells]
        shear = solve_traction(
            press,
            self.pad.position_mm[cells],
            self._skin_of(cells),
            contact.force_N[:, :2],
            contact.torsion_Nmm,
            self.options.friction,
        )
        return Traction(cells, press, shear)

    def _skin_of(self, cells: np.ndarray) -> CellSkin:
        """Return these cells' part of the skin; a held object presses the same ones for long."""
        if not np.array_equal(cells, self._pressed):
            self._pressed = cells
            self._skin = CellSkin.of(self.pad.influence.skin, cells)
        return self._skin

    def _markers(self, traction: Traction, noise: bool) -> tuple[np.ndarray, np.ndarray]:
        if isinstance(self._respond, Drawn):
            discs = self._discs(traction, noise)
            centres_px = np.stack([d.centres_px for d in discs])
            return centres_px, 2 * np.stack([d.radii_px for d in discs])
        motion = self._respond(traction).without(self._dead)
        mm = self.spec.marker_size_mm * self.unit.marker_size * self.unit.view_scale
        size = mm * self.spec.px_per_mm[0] * motion.growth
        return self._disturbed(self._project(self._rest_mm + motion.shift_mm), noise), size

    def _project(self, point_mm: np.ndarray) -> np.ndarray:
        """Return (B, M, 2) pixels of points on the pad: scale, tilted camera, fisheye."""
        rim_mm = max(self.spec.pad_size_mm) / 2
        squeeze = 1 - self.spec.fisheye * (point_mm**2).sum(axis=-1, keepdims=True) / rim_mm**2
        if any(self.unit.tilt):
            squeeze = squeeze * (1 + (point_mm @ np.asarray(self.unit.tilt))[..., None] / rim_mm)
        scale = np.asarray(self.spec.px_per_mm) * self.unit.view_scale
        seen_mm = turned(point_mm * squeeze, self.unit.view_turn_rad) + self.unit.view_shift_mm
        return CENTRE_PX + seen_mm * scale

    def _disturbed(self, centre_px: np.ndarray, noise: bool) -> np.ndarray:
        """Add per-marker noise; lost markers become NaN."""
        B, M, _ = centre_px.shape
        if noise:
            centre_px = centre_px + self._rng.standard_normal((B, M, 2)) * self.options.noise_px
        if self.options.marker_loss:
            lost = self._rng.random((B, M)) < self.options.loss_probability
            centre_px = np.where(lost[..., None], np.nan, centre_px)
        if self._lost.any():
            centre_px = np.where(self._lost[:, None], np.nan, centre_px)
        return centre_px

    def _rows(self, traction: Traction, noise: bool) -> np.ndarray:
        """Return (B, M, 3) float32: whole counts above the baseline, or displacements in mm."""
        assert isinstance(self._respond, Drawn)
        rows = np.where(self._dead[:, None], 0, self._respond(traction))
        rows = rows + np.float32(self.unit.crosstalk) * (rows.mean(axis=1, keepdims=True) - rows)
        if noise:
            scatter = self._rng.standard_normal(rows.shape) * self._row_noise
            rows = rows + scatter.astype(np.float32)
        if self.spec.points:
            return rows
        return np.round(rows)

    def _discs(self, traction: Traction, noise: bool) -> list[TaxelDiscs]:
        rows = self._rows(traction, noise)
        if self.spec.points:
            return [place_points(moved_mm, self.spec) for moved_mm in rows]
        return [place_discs(counts, self.spec, _SCALES) for counts in rows]

    def _images(self, traction: Traction, noise: bool) -> np.ndarray:
        """Return (B, 480, 640) marker images."""
        if isinstance(self._respond, Drawn):
            return np.stack([draw_discs(discs) for discs in self._discs(traction, noise)])
        centre_px, size_px = self._markers(traction, noise)
        if self.spec.marker_shape == "disc":
            return fill_discs(centre_px, size_px)
        turn_rad = self.unit.rotation_rad + self.unit.view_turn_rad
        if self.spec.marker_shape == "diamond":
            turn_rad += np.pi / 4
        return fill_squares(centre_px, size_px, turn_rad)

    def _build_response(self) -> CameraResponse | Drawn:
        rng = np.random.default_rng(self.unit.seed)
        offset = np.asarray(self.unit.offset_mm, dtype=np.float32)
        if self.spec.taxels:
            taxel_mm = self.spec.layout_mm + offset
            spread = 0.5 * self.unit.jitter_mm * rng.standard_normal((len(taxel_mm), 3))
            gain = self.unit.gain * (1 + spread)
        if isinstance(self._material, ForceTaxelMaterial):
            self._baseline = np.zeros(self.spec.raw_shape, int)
            self._row_noise = self._material.noise_counts
            return ForceTaxelResponse(self.pad.position_mm, taxel_mm, self._material, gain)
        if isinstance(self._material, TaxelMaterial):
            self._row_noise = self.options.noise_counts
            shear = rng.integers(*self._material.baseline_shear, size=(len(taxel_mm), 2))
            normal = rng.integers(*self._material.baseline_normal, size=(len(taxel_mm), 1))
            self._baseline = np.concatenate([shear, normal], axis=1)  # raw counts at rest
            return TaxelResponse(
                self.pad.influence, taxel_mm, self._material, gain, 1 / self._stiffness
            )
        scale = self.unit.gain / self._stiffness
        if self.spec.points:
            self._row_noise = self.spec.points.noise_mm
            return PointResponse(self.pad.influence, self.spec.points.place_mm + offset, scale)
        self._rest_mm = self._unit_layout(rng, offset)
        return CameraResponse(self.pad.influence, self._rest_mm, self._material, scale)

    def _damage(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (M,) bool twice: markers that are gone, and those that never move."""
        places_mm = self.spec.layout_mm
        if self.spec.points:
            places_mm = self.spec.points.place_mm
        count = len(places_mm)
        rng = np.random.default_rng([self.unit.seed, 1])
        gone = np.argsort(rng.random(count)) < round(self.unit.lost * count)
        place = places_mm[rng.integers(count)]
        near = np.argsort(np.argsort(np.linalg.norm(places_mm - place, axis=1), kind="stable"))
        return gone, near < round(self.unit.dead * count)

    def _unit_layout(self, rng: np.random.Generator, offset_mm: np.ndarray) -> np.ndarray:
        """Return (M, 2) rest positions of this unit's markers in mm."""
        drawn_mm = turned(self.spec.layout_mm, self.unit.rotation_rad)
        jitter = rng.standard_normal(drawn_mm.shape) * self.unit.jitter_mm
        return (drawn_mm + offset_mm + jitter).astype(np.float32)


def free_air(batch: int) -> ContactState:
    """Return ``batch`` contact states without any contact."""
    gap = np.full((batch, GRID_CELLS, GRID_CELLS), np.inf, dtype=np.float32)
    return ContactState(gap, np.zeros((batch, 3), np.float32), np.zeros(batch, np.float32))


def draw_simulator(
    rng: np.random.Generator,
    sensor: str | VirtualSensor,
    unit_strength: float,
    options: ContactOptions,
    look: Look | None = None,
) -> TactileSimulator:
    """Return a simulator of a random unit, seen by a random camera where ``look`` is given."""
    unit = UnitVariation.draw(rng, sensor, unit_strength)
    if look is not None and as_virtual(sensor).spec.signal == "camera":
        unit = unit.seen_through(rng, look)
    return TactileSimulator(sensor, unit, options, seed=int(rng.integers(2**31)))


def slices(n: int, size: int) -> list[slice]:
    """Return slices that cut ``n`` rows into pieces of ``size``, the last one shorter."""
    return [slice(start, start + size) for start in range(0, n, size)]


def rows_of(contact: ContactState, rows: slice) -> ContactState:
    """Return some rows of a batch of contacts."""
    return ContactState(contact.gap_mm[rows], contact.force_N[rows], contact.torsion_Nmm[rows])


def images_of(
    simulator: TactileSimulator, contact: ContactState, transform: Transform | None = None
) -> np.ndarray:
    """Return (B, …) images chunk by chunk, so that only a transform's (small) results pile up."""
    chunks = []
    for part in slices(len(contact.gap_mm), _CHUNK):
        images = simulator.marker_images(rows_of(contact, part))
        if transform:
            images = transform(images)
        chunks.append(images)
    return np.concatenate(chunks)
