"""Raw signal of any known sensor → canonical marker image."""

from __future__ import annotations

import numpy as np

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE, Finger, MarkerPair, check_finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.markers.camera_markers import (
    Segmentation,
    check_frame,
    fit_canonical,
    looks_alike,
    segment,
    thumbnail,
)
from uniforce_vtla.markers.marker_blobs import MarkerPlan, SegmentationSettings
from uniforce_vtla.markers.marker_plan import choose_plan
from uniforce_vtla.markers.nominal_scale import (
    points_to_nominal_scale,
    to_nominal_scale,
)
from uniforce_vtla.markers.reference import NoContactCheck, ReferenceMemory, refuse_pressed_reference
from uniforce_vtla.markers.taxel_render import (
    Saturation,
    TaxelDiscs,
    TaxelScales,
    check_alive,
    check_counts,
    draw_discs,
    place_discs,
)
from uniforce_vtla.sensors import get_sensor


class Canonicalizer:
    """Turns one sensor's raw signal into marker images, as the sensor sees them (never flipped).

    Cameras: the way to see the markers (channel, polarity, scale) is found in a frame and kept for the frames that
    look like it; once there is a reference, its way is used, and the image is brought to nominal scale by the spec's
    px/mm. Taxels: counts are drawn relative to the reference.

    Attributes:
        sensor: registry name.
        saturation: what taxel rendering had to clip so far; stays 0 for cameras.
    """

    def __init__(
        self,
        sensor: str,
        taxel_scales: TaxelScales | None = None,
    ) -> None:
        self.spec = get_sensor(sensor)
        self.sensor = sensor
        self.saturation = Saturation()
        self._taxel_scales = taxel_scales or TaxelScales()
        self._segmentation = SegmentationSettings()
        self._reference_counts: np.ndarray | None = None
        self._plan: MarkerPlan | None = None
        self._recent: tuple[np.ndarray, MarkerPlan] | None = None
        self._references: ReferenceMemory[Segmentation] = ReferenceMemory(1)

    def set_reference(self, raw: np.ndarray) -> None:
        """Take ``raw`` as the free-air state: counts to subtract, or the frame to learn from how markers look.

        Raises:
            ContractError: wrong shape or dtype.
            SensorError: a camera frame without markers, or a dead sensor: a tared one still reads noise.
        """
        if self._is_taxel:
            self._reference_counts = _free_air(raw)
        else:
            self._plan = self._segment(raw, None).plan

    def pair(
        self, reference_raw: np.ndarray, current_raw: np.ndarray, finger: Finger, reference_from: str = "own"
    ) -> MarkerPair:
        """Return the marker pair of two raw signals of one sensor; leaves ``set_reference`` as it was.

        Args:
            reference_raw: free-air frame (H, W, 3) uint8 RGB, or (16, 3) integer counts.
            current_raw: the same, now.
            finger: the finger that wears the sensor.
            reference_from: "own", or where a borrowed reference came from.

        Raises:
            ContractError: shape, dtype or finger outside the contract, or frames of different size.
            SensorError: no markers, dark, dead, or a reference that was pressed.
        """
        check_finger(finger)
        images = self._taxel_pair if self._is_taxel else self._camera_pair
        reference, current = images(reference_raw, current_raw)
        return MarkerPair(reference, current, finger, self.sensor, reference_from)

    def marker_image(self, raw: np.ndarray) -> np.ndarray:
        """Return the (480, 640) uint8 image in {0, 255} of a frame (H, W, 3) uint8 RGB or counts (16, 3).

        Raises:
            ContractError: wrong shape or dtype, or taxels without a reference.
            SensorError: no markers, dark or dead.
        """
        if not self._is_taxel:
            return to_nominal_scale(self._segment(raw, self._plan_for(raw)).image, self.spec)
        discs = self._discs(raw, self._known_reference())
        self.saturation.add(discs)
        return draw_discs(discs)

    def markers(self, raw: np.ndarray) -> np.ndarray:
        """Return (M, 2) float32 marker centres, x right and y down, in px of the canonical image.

        Raises:
            ContractError: as ``marker_image``.
            SensorError: as ``marker_image``.
        """
        if not self._is_taxel:
            centres_px = self._segment(raw, self._plan_for(raw)).centres_px
            return points_to_nominal_scale(centres_px, self.spec, MARKER_IMAGE_SHAPE)
        return self._discs(raw, self._known_reference()).centres_px

    @property
    def _is_taxel(self) -> bool:
        return self.spec.signal == "taxel"

    def _segment(self, raw: np.ndarray, plan: MarkerPlan | None) -> Segmentation:
        return segment(raw, self._segmentation, self.spec.dome_radius_mm is not None, plan)

    def _plan_for(self, raw: np.ndarray) -> MarkerPlan:
        """Return the reference's plan, or the recent one where the frame looks alike, or a new one."""
        if self._plan is not None:
            return self._plan
        look = thumbnail(check_frame(raw))
        if self._recent is not None and looks_alike(look, self._recent[0]):
            return self._recent[1]
        plan, _ = choose_plan(fit_canonical(raw), self._segmentation)
        self._recent = (look, plan)
        return plan

    def _camera_pair(
        self, reference_raw: np.ndarray, current_raw: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        reference = self._references.get("", reference_raw, lambda: self._segment(reference_raw, None))
        shapes = np.shape(reference_raw), np.shape(current_raw)
        if shapes[0] != shapes[1]:
            do = "Use one camera setting for both."
            raise ContractError(expected("current frame", shapes[0], shapes[1], do))
        current = self._segment(current_raw, reference.plan)
        return to_nominal_scale(reference.image, self.spec), to_nominal_scale(current.image, self.spec)

    def _taxel_pair(
        self, reference_raw: np.ndarray, current_raw: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        reference = _free_air(reference_raw)
        discs = self._discs(current_raw, reference)
        refuse_pressed_reference(current_raw.astype(np.int64) - reference, NoContactCheck())
        self.saturation.add(discs)
        return draw_discs(place_discs(np.zeros_like(reference), self._taxel_scales)), draw_discs(discs)

    def _discs(self, raw: np.ndarray, reference: np.ndarray) -> TaxelDiscs:
        counts = check_counts(raw)
        check_alive(counts)
        return place_discs(counts - reference, self._taxel_scales)

    def _known_reference(self) -> np.ndarray:
        if self._reference_counts is None:
            do = "Call set_reference(counts) with a free-air scan first."
            raise ContractError(expected("uSkin reference", "(16, 3) counts in free air", "none", do))
        return self._reference_counts


def _free_air(raw: np.ndarray) -> np.ndarray:
    """Return a reference's counts (16, 3) int64, if it came from a live sensor."""
    return check_alive(check_counts(raw, "uSkin reference"), "uSkin reference")
