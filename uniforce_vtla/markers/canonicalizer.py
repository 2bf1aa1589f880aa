"""Raw signal of any known sensor → canonical marker image."""

from collections.abc import Sequence

import numpy as np

from uniforce_vtla.contracts import (
    MARKER_IMAGE_SHAPE,
    TAXEL_SHAPE,
    Finger,
    MarkerPair,
    check_finger,
)
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.markers.camera_markers import Segmentation, fit_canonical, segment
from uniforce_vtla.markers.marker_hold import MarkerHold
from uniforce_vtla.markers.marker_reference import WARN_SHARE, MarkerMatch, MarkerReference
from uniforce_vtla.markers.point_render import check_points, is_pressed, place_points
from uniforce_vtla.markers.reference import (
    ReferenceMemory,
    capture_camera_reference,
    capture_row_reference,
    capture_taxel_reference,
    refuse,
    refuse_pressed_reference,
)
from uniforce_vtla.markers.registration import (
    find_view,
    points_to_nominal_scale,
    seen_from,
    to_nominal_scale,
)
from uniforce_vtla.markers.taxel_render import (
    TaxelDiscs,
    TaxelScales,
    check_alive,
    check_counts,
    draw_discs,
    place_discs,
)
from uniforce_vtla.sensors import get_sensor

# times the spec's markers or a quarter: gels of one kind carry 25 to 266, domes 127 or 331
LIKELY_COUNT = 4
# while a reference is taken: of a tared taxel's number, and of a point's, times its noise
MAX_COUNT_STD = 3.0
MAX_POINT_STD = 10.0


class Canonicalizer:
    """Turns one sensor's raw signal into marker images, as the sensor sees them (never flipped).

    Cameras: the way to see the markers (channel, polarity, scale) is found in the reference, and
    its markers are looked for (``MarkerReference``); before there is one, the way is found in every
    frame. The image is moved so that the reference's pattern lies as in the spec's drawing; another
    pattern is brought to nominal scale by the spec's px/mm. Taxels and points: counts or
    displacements are drawn relative to the reference.

    Args:
        sensor: a registered name.
        taxel_scales: None: those of the sensor's form.
        register: False leaves a camera's pattern as it was mounted, as frozen sets made before
            registration did.
        warn_share: of a camera's markers lost, which is warned of once.
        stream: frames follow one another: a camera's markers that are missed for a few of them stay
            where they were.

    Attributes:
        match: how the latest camera frame read against a reference matches it; None before.
    """

    def __init__(
        self,
        sensor: str,
        taxel_scales: TaxelScales | None = None,
        register: bool = True,
        warn_share: float = WARN_SHARE,
        stream: bool = False,
    ) -> None:
        self.spec = get_sensor(sensor)
        self._register = register
        self._warn_share = warn_share
        self.sensor = sensor
        self.match: MarkerMatch | None = None
        self._stream = stream
        self._hold: MarkerHold | None = None
        self._is_dome = self.spec.dome_radius_mm is not None
        self._taxel_scales = taxel_scales or TaxelScales()
        self._reference_rows: np.ndarray | None = None  # counts or displacements
        self._reference: MarkerReference | None = None
        self._view: np.ndarray | None = None  # (3, 3) onto the drawing, of the reference
        self._references: ReferenceMemory[tuple[MarkerReference, np.ndarray | None]] = (
            ReferenceMemory(1)
        )

    def free_air(self, frames: Sequence[np.ndarray]) -> np.ndarray:
        """Return one free-air signal of several in a row, for ``set_reference``.

        Raises ContractError: too few, or of several sizes; SensorError: dead, or moving between
        them.
        """
        if self.spec.signal == "camera":
            return capture_camera_reference(frames, [self.markers(frame) for frame in frames])
        if self.spec.raw_shape == TAXEL_SHAPE:
            return capture_taxel_reference(frames)
        checked = [self._checked(frame, "reference") for frame in frames]
        most = MAX_COUNT_STD
        if self.spec.points is not None:
            most = MAX_POINT_STD * self.spec.points.noise_mm
        return capture_row_reference(checked, most).astype(checked[0].dtype)

    def set_reference(self, raw: np.ndarray) -> None:
        """Take ``raw`` as the free-air state.

        Counts to subtract, or the frame to learn from how markers look.

        Raises ContractError: wrong shape or dtype; SensorError: a camera frame without markers or
        with an unlikely number of them, or a dead sensor, where zeros can't be a live one's.
        """
        if self._is_drawn:
            self._reference_rows = self._checked(raw, "reference")
        else:
            self._reference, self._view = self._remember(raw)
            self.match = None
            self._hold = None
            if self._stream:
                self._hold = MarkerHold(self._reference.spacing_px)

    def pair(
        self, reference_raw: np.ndarray, current_raw: np.ndarray, finger: Finger
    ) -> MarkerPair:
        """Return the marker pair of two raw signals of one sensor.

        Leaves ``set_reference`` as it was.

        Args:
            reference_raw: free-air frame (H, W, 3) uint8 RGB, (M, 3) integer counts of M taxels, or
                (N, 3) float mm of N points.
            current_raw: the same, now.
            finger: the finger that wears the sensor.

        Raises ContractError: shape, dtype or finger outside the contract, or frames of different
        size; SensorError: no markers, too few of the reference's, dark, dead, or a reference that
        was pressed.
        """
        check_finger(finger)
        pair_of = self._drawn_pair if self._is_drawn else self._camera_pair
        reference, current = pair_of(reference_raw, current_raw)
        return MarkerPair(reference, current, finger, self.sensor)

    def marker_image(self, raw: np.ndarray) -> np.ndarray:
        """Return the (480, 640) uint8 image in {0, 255} of a raw signal, as ``pair`` takes it.

        Raises ContractError: wrong shape or dtype, a frame of another size than the reference, or
        taxels without a reference; SensorError: no markers, too few of the reference's, dark or
        dead.
        """
        if not self._is_drawn:
            return self._camera_image(raw, self._reference, self._view, self._hold)
        return draw_discs(self._discs(raw, self._reference_rows))

    def markers(self, raw: np.ndarray) -> np.ndarray:
        """Return (M, 2) float32 marker centres, x right and y down, in px of the canonical image.

        Of a camera all that the frame shows, since references are chosen by them: they are held to
        none.

        Raises ContractError: as ``marker_image``; SensorError: no markers, dark or dead.
        """
        if not self._is_drawn:
            return points_to_nominal_scale(
                self._segment(raw).centres_px, self.spec, MARKER_IMAGE_SHAPE
            )
        return self._discs(raw, self._reference_rows).centres_px

    @property
    def _is_drawn(self) -> bool:
        return self.spec.signal != "camera"

    def _remember(self, raw: np.ndarray) -> tuple[MarkerReference, np.ndarray | None]:
        count = len(self.spec.layout_mm)
        counts = count // LIKELY_COUNT, count * LIKELY_COUNT
        found = MarkerReference(raw, self._is_dome, counts, self._warn_share)
        if not self._register:
            return found, None
        return found, find_view(found.centres_px, self.spec)

    def _camera_image(
        self,
        raw: np.ndarray,
        reference: MarkerReference | None,
        view: np.ndarray | None,
        hold: MarkerHold | None = None,
    ) -> np.ndarray:
        if reference is None:
            return to_nominal_scale(self._segment(raw).image(), self.spec)
        image, self.match = reference.read(raw, hold)
        return self._placed(image, view)

    def _placed(self, image: np.ndarray, view: np.ndarray | None) -> np.ndarray:
        if view is None:
            return to_nominal_scale(image, self.spec)
        return seen_from(image, view)

    def _segment(self, raw: np.ndarray) -> Segmentation:
        plan = None if self._reference is None else self._reference.plan
        return segment(fit_canonical(raw), self._is_dome, plan)

    def _camera_pair(self, free: np.ndarray, current: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        reference, view = self._references.get("", free, lambda: self._remember(free))
        return self._placed(reference.image, view), self._camera_image(current, reference, view)

    def _drawn_pair(self, free: np.ndarray, current: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        reference = self._checked(free, "reference")
        discs = self._discs(current, reference)
        self._refuse_pressed(current.astype(reference.dtype) - reference)
        return draw_discs(self._placed_discs(np.zeros_like(reference))), draw_discs(discs)

    def _refuse_pressed(self, change: np.ndarray) -> None:
        if self.spec.taxels is not None:
            refuse_pressed_reference(change * self.spec.taxels.worth)
        elif is_pressed(change):
            refuse("points at or below it", f"{-change[:, 2].min():.2f} mm above it")

    def _discs(self, raw: np.ndarray, reference: np.ndarray | None) -> TaxelDiscs:
        if reference is None:
            do = "Call set_reference(raw) with a free-air scan first."
            wanted = f"{self.spec.raw_shape} in free air"
            raise ContractError(expected(f"{self.sensor} reference", wanted, "none", do))
        return self._placed_discs(self._checked(raw, self.spec.signal) - reference)

    def _placed_discs(self, change: np.ndarray) -> TaxelDiscs:
        if self.spec.points is not None:
            return place_points(change, self.spec)
        return place_discs(change, self.spec, self._taxel_scales)

    def _checked(self, raw: np.ndarray, what: str) -> np.ndarray:
        """Return the counts (M, 3) int64, or displacements (N, 3) float64, of a live sensor."""
        name = f"{self.sensor} {what}"
        if self.spec.points is not None:
            return check_alive(check_points(raw, name, self.spec.raw_shape), name)
        counts = check_counts(raw, name, self.spec.raw_shape)
        tared = self.spec.taxels is not None and self.spec.taxels.tared
        return counts if tared else check_alive(counts, name)
