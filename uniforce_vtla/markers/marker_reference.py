"""The markers of a free-air frame, remembered: later frames of that camera are held against them.

Lost markers are counted, without correspondence. A marker of the current frame is an extra where no
reference marker lies within reach, where it stands between markers that hardly moved, or on a
reflection of the reference. A marker which the reference missed stays; so does a new reflection on
a moving pattern, because a sheared dome's pin passes its neighbour's place.
"""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from uniforce_vtla.errors import ContractError, SensorError, expected
from uniforce_vtla.markers.camera_markers import Segmentation, fit_canonical, segment
from uniforce_vtla.markers.marker_blobs import spacing
from uniforce_vtla.markers.marker_hold import MarkerHold

WARN_SHARE = 0.05  # of the reference's markers lost: said once
RETRY_SHARE = 0.20  # lost: other channels are tried
# lost: refused; honest contacts at full load lose up to 12.5 % (GelSight) and 18.9 % (TacTip)
REFUSE_SHARE = 0.25
RETRIES = ("least", "gray", "blue", "value")  # those channels, in this order
# spacings: a marker's greatest motion; simulated pins move 1.7 under 16 N and 8 N of shear
REACH = 2.0
STILL = 0.3  # spacings: where 98 % moved less, a marker's nearest reference is its own
SAME_PLACE = 0.2  # spacings: a reflection of the reference is found again this near
BETWEEN = 0.75  # spacings: what lies nearer than this to two markers is none of their pattern


@dataclass(frozen=True)
class MarkerMatch:
    """How the markers of a camera frame answer to the reference's."""

    matched: int  # markers of the reference found
    lost: int  # and not found
    dropped: int  # blobs that looked like markers and match none


class MarkerReference:
    """Reads frames as the free-air frame was read: same polarity, scale, rim and markers.

    Args:
        frame: (H, W, 3) uint8 RGB, in free air.
        dome: see ``segment``.
        counts: fewest and most markers the sensor may have.
        warn_share: of the markers lost, which is warned of once.

    Raises ContractError: wrong shape or dtype; SensorError: a dark frame, no markers, or another
    number of them than this sensor has.
    """

    def __init__(
        self, frame: np.ndarray, dome: bool, counts: tuple[int, int], warn_share: float = WARN_SHARE
    ) -> None:
        found = segment(fit_canonical(frame), dome)
        between = between_markers(found.blobs.markers, np.ones(found.blobs.keep.sum(), bool))
        self._reflections = found.blobs.markers[between]
        self._found = replace(found, blobs=found.blobs.without(between))
        points = self._found.blobs.markers
        if not counts[0] <= len(points) <= counts[1]:
            wanted = f"{counts[0]} to {counts[1]} markers"
            do = "Is it this sensor's own picture, and in focus?"
            raise SensorError(expected("reference frame", wanted, len(points), do))
        self._dome = dome
        self._warn_share = warn_share
        self._warned = False
        self._shape = frame.shape
        self._tree = cKDTree(points)
        self.spacing_px = spacing(points)
        self.plan = self._found.plan
        self.centres_px = self._found.centres_px  # (M, 2), of ``image``
        self.image = self._found.image()  # (480, 640) uint8 in {0, 255}

    def read(
        self, frame: np.ndarray, hold: MarkerHold | None = None
    ) -> tuple[np.ndarray, MarkerMatch]:
        """Return the (480, 640) uint8 image in {0, 255} of a frame's markers, and how they match.

        Other channels are tried where 20 % of the markers are lost. Markers that ``hold`` fills in
        are not lost. Warns once at ``warn_share``.

        Raises ContractError: wrong dtype, or another shape than the reference's; SensorError: a
        dark frame, no markers, 25 % of the reference's lost, or more extras than markers.
        """
        working = fit_canonical(frame)
        if frame.shape != self._shape:
            do = "Use one camera setting for both, or take the reference again."
            raise ContractError(expected("current frame", self._shape, frame.shape, do))
        found, match = self._best(working, hold)
        image = found.image()
        held = hold.fill(image, found.centres_px, match.lost) if hold else 0
        match = replace(match, matched=match.matched + held, lost=match.lost - held)
        wanted = f"the {self._tree.n} markers of the reference"
        if self._misses(match, REFUSE_SHARE):
            came = f"{match.matched} of them and {match.dropped} others"
            do = "Check light and focus, clean the gel, or take the reference again."
            raise SensorError(expected("camera frame", wanted, came, do))
        if match.lost >= self._warn_share * self._tree.n and not self._warned:
            self._warned = True
            do = "Force is misread where markers are missing: check light and focus."
            warnings.warn(
                expected("camera frame", wanted, f"{match.matched} of them", do), stacklevel=3
            )
        return image, match

    def _best(
        self, working: np.ndarray, hold: MarkerHold | None
    ) -> tuple[Segmentation, MarkerMatch]:
        """Return the first reading with enough markers, held ones included, else the fullest."""
        seen = []
        failures = []
        own = self.plan.channel
        # specks may outvote markers, so next the reference gives the size; then other channels
        ways = [(own, None), (own, self._found.blobs.marker_area)]
        ways += [(channel, None) for channel in RETRIES if channel != own]
        for channel, marker_area in ways:
            try:
                plan = replace(self.plan, channel=channel)
                found = segment(working, self._dome, plan, self._found.rim, marker_area)
            except SensorError as error:
                failures.append(error)
                continue
            found, match = self._match(found)
            seen.append((found, match))
            held = len(hold.missed(found.centres_px, match.lost)) if hold else 0
            if not self._misses(replace(match, lost=match.lost - held), RETRY_SHARE):
                return found, match
        if not seen:
            raise failures[0]
        return max(seen, key=lambda pair: pair[1].matched)

    def _misses(self, match: MarkerMatch, share: float) -> bool:
        return match.lost >= share * self._tree.n or match.dropped > self._tree.n

    def _match(self, found: Segmentation) -> tuple[Segmentation, MarkerMatch]:
        extra = self._extras(found.blobs.markers)
        dropped = int(extra.sum())
        matched = min(self._tree.n, len(extra) - dropped)
        match = MarkerMatch(matched, self._tree.n - matched, dropped)
        return replace(found, blobs=found.blobs.without(extra)), match

    def _extras(self, points: np.ndarray) -> np.ndarray:
        """Return (M,) bool: which of (M, 2) points match no marker of the reference."""
        distance, nearest = self._tree.query(points)
        distance /= self.spacing_px
        extra = distance > REACH
        order = np.argsort(-distance)
        closest = np.full(self._tree.n, -1)
        # of several that share a nearest one, the closest is written last
        closest[nearest[order]] = order
        shared = ~extra
        shared[closest[closest >= 0]] = False
        if shared.any() and np.percentile(distance[~extra & ~shared], 98) < STILL:
            extra[shared] = between_markers(points, shared)
            return extra
        surplus = len(points) - int(extra.sum()) - self._tree.n
        if surplus > 0 and len(self._reflections):
            offset = cKDTree(self._reflections).query(points)[0] / self.spacing_px
            nearest = np.argsort(offset)[:surplus]
            extra[nearest[offset[nearest] < SAME_PLACE]] = True
        return extra


def between_markers(points: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """Return which of the (M,) bool ``asked`` of (M, 2) points stand between others of a pattern.

    Such a point is nearer to two others than each of these is to its own second neighbour.
    """
    tree = cKDTree(points)
    distance, index = tree.query(points[asked], k=7)
    second = tree.query(points[index[:, 1:]], k=3)[0][..., 2]
    return (distance[:, 1:] < BETWEEN * second).sum(axis=1) >= 2
