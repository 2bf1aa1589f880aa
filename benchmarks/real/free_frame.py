"""Find the free-air frame of each film in a session, by the marker pattern of its pad.

One film alone doesn't show it: a steady grasp holds as still as free air, and the most even pattern
may be an even press. But a pad in free air shows the same pattern in every film, while each object
deforms it differently. So the pattern that most objects share is the pad's own, and a film's free
frame is the one nearest to it.

Pads are mounted anew between objects, so patterns are compared up to shift, rotation and scale.
Points are complex numbers x + iy: a similarity is one factor and one offset, fitted in closed form.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.markers.marker_blobs import spacing

# rms over markers below which two frames count as equal; segmentation and lens leave .2 to .6
SAME_px = 0.8
REACH = 0.45  # spacings: a marker's motion within which it is found again
SHARED = 0.85  # least share of common markers; the image border cuts some off
# least share of markers in place in one frame for the film to show the same printed pad
PRINT_SHARE = 0.5
FEWEST_OBJECTS = 3  # that must share a pattern; repeated grasps of one object look equal too
ROUNDS = 10  # of matching and fitting


@dataclass(frozen=True)
class Film:
    """Frames of one finger's film that were looked at."""

    held: str  # object in the grasp; films of one object may show the same grasp
    centres_px: Sequence[np.ndarray]  # of each frame (M, 2) markers


@dataclass(frozen=True)
class FreeFrame:
    """Where a film's free frame is."""

    film: int  # of the session; another one than asked about where it is borrowed
    frame: int  # of those looked at
    off_px: float  # rms over markers, from the pad's pattern
    pad: int  # which pattern of the session it is


@dataclass(frozen=True)
class Pad:
    """A pad's pattern in free air, and the films that show that pad."""

    centres_px: np.ndarray  # (M, 2), as one of its films shows it
    films: tuple[int, ...]


class _Tracked:
    """A film's markers by number: (frames, M) complex px, NaN where one isn't found."""

    def __init__(self, film: Film) -> None:
        counts = [len(centres_px) for centres_px in film.centres_px]
        self.base = film.centres_px[int(np.argmax(counts))]  # (M, 2): the frame that shows most
        self.spacing_px = spacing(self.base)
        places = [_places(self.base, other, self.spacing_px) for other in film.centres_px]
        self.places = np.array(places)


def pads(films: Sequence[Film]) -> tuple[list[Pad], list[FreeFrame | None]]:
    """Return the pads of a session, and each film's free frame, or None.

    A film has none if it shows contact only, or if its pad was filmed with too few other objects.

    Raises ContractError: no film, or a film without frames.
    """
    if not films or not all(len(film.centres_px) for film in films):
        raise ContractError(
            expected("films", "one or more, of one frame or more", len(films), "Record a session.")
        )
    tracked = [_Tracked(film) for film in films]
    shared, apart_px = _compare(tracked)
    found: list[Pad] = []
    free: list[FreeFrame | None] = [None] * len(films)
    left = set(range(len(films)))
    while (common := _commonest(films, apart_px, left)) is not None:
        film, frame = common
        pattern = tracked[film].places[frame]
        members = []
        for other in sorted(left):
            pair = film, other
            if pair not in shared or not _shows_print(pattern, tracked[other], shared[pair]):
                continue
            members.append(other)
            off_px = apart_px[pair][frame]
            best = int(np.argmin(off_px))
            if off_px[best] < SAME_px:
                free[other] = FreeFrame(other, best, float(off_px[best]), len(found))
        found.append(Pad(films[film].centres_px[frame], tuple(members)))
        left -= set(members)
    return found, free


def borrowed(
    films: Sequence[Film], pads: Sequence[Pad], free: Sequence[FreeFrame | None]
) -> list[FreeFrame | None]:
    """Return ``free`` with gaps filled by a free frame of the same pad; None if that pad has none.

    A film of the same object comes first, for pads are mounted anew between objects. On real films
    its frame lies .7 to .9 px (median) from the film's own, any other of the pad 1 px.
    """
    whole = list(free)
    for pad in pads:
        own = [frame for film in pad.films if (frame := free[film]) is not None]
        own.sort(key=lambda frame: frame.off_px)
        for film in pad.films:
            if free[film] is None and own:
                held = films[film].held
                whole[film] = min(own, key=lambda frame: films[frame.film].held != held)
    return whole


def _places(base: np.ndarray, centres_px: np.ndarray, spacing_px: float) -> np.ndarray:
    """Return (M,) complex places of ``base``'s (M, 2) markers in another frame, NaN if missing."""
    distance, nearest = cKDTree(centres_px).query(base)
    back = cKDTree(base).query(centres_px)[1]
    is_found = (distance < REACH * spacing_px) & (back[nearest] == np.arange(len(base)))
    places = centres_px[nearest].astype(np.float64) @ np.array([1, 1j])
    return np.where(is_found, places, np.nan)


def _compare(
    tracked: Sequence[_Tracked],
) -> tuple[dict[tuple[int, int], tuple[np.ndarray, np.ndarray]], dict[tuple[int, int], np.ndarray]]:
    """Return matching marker indices and (frames, frames) rms distances in px by (film, film).

    Both orders of two films of one layout are there.
    """
    shared = {}
    apart_px = {}
    for one, first in enumerate(tracked):
        for other, second in enumerate(tracked[: one + 1]):
            pairs = _same_markers(first, second)
            if pairs is not None:
                px = _apart_px(first.places[:, pairs[0]], second.places[:, pairs[1]])
                shared[one, other] = pairs
                shared[other, one] = pairs[::-1]
                apart_px[one, other] = px
                apart_px[other, one] = px.T
    return shared, apart_px


def _same_markers(first: _Tracked, second: _Tracked) -> tuple[np.ndarray, np.ndarray] | None:
    """Return matching marker indices of two films, up to a similarity; None if too few match."""
    points = first.base.astype(np.float64)
    others = second.base.astype(np.float64)
    most = max(len(points), len(others))
    if min(len(points), len(others)) < SHARED * most:
        return None
    moved = points
    reach_px = REACH * second.spacing_px
    for _ in range(ROUNDS):
        distance, nearest = cKDTree(others).query(moved)
        near = distance < reach_px
        if near.sum() < SHARED * most:
            return None
        matrix, _ = cv2.estimateAffinePartial2D(points[near], others[nearest[near]])
        if matrix is None:
            return None
        moved = points @ matrix[:, :2].T + matrix[:, 2]
    is_alone = np.bincount(nearest, minlength=len(others))[nearest] == 1
    numbers = np.flatnonzero(near & is_alone)
    if len(numbers) < SHARED * most:
        return None
    return numbers, nearest[numbers]


def _shows_print(frame: np.ndarray, film: _Tracked, pairs: tuple[np.ndarray, np.ndarray]) -> bool:
    """Return whether a film shows the printed pad of a frame (M,), complex px, outside contact.

    Pads of one layout differ by a few pixels in print.
    """
    pattern = frame[pairs[0]]
    for places in film.places[:, pairs[1]]:
        both = np.isfinite(pattern) & np.isfinite(places)
        if both.sum() < PRINT_SHARE * len(pattern):
            continue
        here = pattern[both].view(np.float64).reshape(-1, 2)
        there = places[both].view(np.float64).reshape(-1, 2)
        _, inliers = cv2.estimateAffinePartial2D(here, there, ransacReprojThreshold=SAME_px)
        if inliers is not None and inliers.sum() >= PRINT_SHARE * len(pattern):
            return True
    return False


def _apart_px(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (F, G) rms distances of frames (F, M) and (G, M), complex px, after a similarity."""
    a = np.nan_to_num(first)
    b = np.nan_to_num(second)
    w = np.isfinite(first).astype(np.float64)
    v = np.isfinite(second).astype(np.float64)
    count = np.maximum(w @ v.T, 1)
    a_sum = a @ v.T
    b_sum = w @ b.T
    aa = (np.abs(a) ** 2) @ v.T - np.abs(a_sum) ** 2 / count
    bb = w @ (np.abs(b) ** 2).T - np.abs(b_sum) ** 2 / count
    ab = a.conj() @ b.T - a_sum.conj() * b_sum / count
    left = np.maximum(bb - np.abs(ab) ** 2 / np.maximum(aa, 1e-9), 0)
    is_enough = count >= SHARED * first.shape[1]
    return np.where(is_enough, np.sqrt(left / count), np.inf)


def _commonest(
    films: Sequence[Film], apart_px: dict[tuple[int, int], np.ndarray], left: set[int]
) -> tuple[int, int] | None:
    """Return film and frame of the pattern that most objects share; None if too few share one."""
    best = None
    most = (FEWEST_OBJECTS - 1, 0.0)
    for film in sorted(left):
        nearest_px: dict[str, np.ndarray] = {}  # object → (frames,)
        for other in left:
            if (film, other) in apart_px:
                held = films[other].held
                again_px = apart_px[film, other].min(axis=1)
                nearest_px[held] = np.minimum(nearest_px.get(held, np.inf), again_px)
        if not nearest_px:
            continue
        stacked_px = np.array(list(nearest_px.values()))  # (objects, frames)
        objects = (stacked_px < SAME_px).sum(axis=0)
        nearness = -np.minimum(stacked_px, SAME_px).mean(axis=0)
        frame = max(range(len(objects)), key=lambda one: (objects[one], nearness[one]))
        if (objects[frame], nearness[frame]) > most and objects[frame] >= FEWEST_OBJECTS:
            best = film, frame
            most = (int(objects[frame]), float(nearness[frame]))
    return best
