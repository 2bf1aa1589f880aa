"""References of real films: how many frames are read, which films have a free frame, and how sure it is.

Markers alone are looked at, of all objects; no force is read. Films of one campaign are one session here.
"""

import sys
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

from benchmarks.real.grasps import SEALED, SENSOR
from uniforce_cli.boundary import command, one_thread
from uniforce_datasets.readers.films import film_frames
from uniforce_datasets.readers.gelsight_grasps import GraspTrial, read_grasps
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import ContractError, SensorError, expected
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.film_markers import SETTLE, STEP, FilmMarkers, read_markers
from uniforce_vtla.markers.free_frame import REACH, Film, FreeFrame, Pad, borrowed, pads
from uniforce_vtla.markers.marker_blobs import spacing
from uniforce_vtla.markers.marker_reference import WARN_SHARE
from uniforce_vtla.options import FolderPath, OutFile
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.mount_relation import mount_relation

SPLITS = 20  # of a pad's objects in halves
ROUNDS = 10  # of matching and fitting


@dataclass
class ReferencesCommand:
    """Take references of real films and count what is refused, found and borrowed.

    Example: python -m benchmarks.real.references grasps=Incipient-Slip-Detection/docs/franka-servo/datasets
    """

    grasps: FolderPath = ""  # of two GelSight Minis
    out: OutFile = "outputs/references.json"


@dataclass(frozen=True)
class Seen:
    """One finger's film, and its markers."""

    trial: GraspTrial
    path: Path
    markers: FilmMarkers


def campaign_rows(trials: Sequence[GraspTrial]) -> dict[str, Any]:
    """Return what one campaign's films show."""
    films = [
        Seen(trial, trial.films[finger], read_markers(film_frames(trial.films[finger]), SENSOR))
        for trial in tqdm(trials, desc="markers", unit="trial")
        for finger in FINGERS
    ]
    session = [Film(seen.trial.object_name, seen.markers.centres_px) for seen in films]
    known, free = pads(session)
    return {
        "films": len(films),
        "trials": len(trials),
        "objects": len({film.held for film in session}),
        "frames": sum(len(seen.markers.numbers) + len(seen.markers.refused) for seen in films),
        "without_markers": sum(len(seen.markers.refused) for seen in films),
        "free": free_rows(known, free),
        "pads": [pad_row(pad, session, free) for pad in known],
        "borrowed_px": borrowed_rows(session, known, free),
        "read": read_rows(films, borrowed(session, known, free)),
        "mounts": mount_rows(films),
    }


def free_rows(known: Sequence[Pad], free: Sequence[FreeFrame | None]) -> dict[str, Any]:
    """Return how many films have a free frame, and how far those lie from the frame that most objects share."""
    off_px = [frame.off_px for frame in free if frame is not None and not _is_middle(frame)]
    of_pad = {film for pad in known for film in pad.films}
    own = sum(frame is not None for frame in free)
    return {
        "own": own,
        "contact_only": len(of_pad) - own,
        "pattern_not_shared": len(free) - len(of_pad),
        "off_px": _spread(off_px),
    }


def pad_row(pad: Pad, session: Sequence[Film], free: Sequence[FreeFrame | None]) -> dict[str, Any]:
    """Return how well the pad's pattern is known: mean patterns of half of its objects against the others'."""
    own = [frame for film in pad.films if (frame := free[film]) is not None]
    held = [session[frame.film].held for frame in own]
    # (films, M, 2)
    places_px = np.stack([placed(pad.centres_px, _centres(session, frame)) for frame in own])
    objects = sorted(set(held))
    rng = np.random.default_rng(0)
    apart_px = []
    for _ in range(SPLITS):
        chosen = set(rng.permutation(objects)[::2].tolist())
        is_first = np.array([name in chosen for name in held])
        apart_px.append(_apart_px(_mean(places_px[is_first]), _mean(places_px[~is_first])))
    numbers = {
        "films": len(pad.films),
        "free": len(own),
        "objects": len(objects),
        "markers": len(pad.centres_px),
    }
    return numbers | {"halves_apart_px": _spread(apart_px)}


def borrowed_rows(
    session: Sequence[Film], known: Sequence[Pad], free: Sequence[FreeFrame | None]
) -> dict[str, dict[str, float]]:
    """Return how far a borrowed frame lies from the film's own, rms over markers as the camera sees them, px.

    Each film that has a free frame is asked as if it had none. ``any_object`` ignores what was held.
    """
    nameless = [Film("", film.centres_px) for film in session]
    found: dict[str, list[float]] = {"same_object_first": [], "any_object": []}
    for number, own in enumerate(free):
        if own is None:
            continue
        others = [*free[:number], None, *free[number + 1 :]]
        for name, films in (("same_object_first", session), ("any_object", nameless)):
            lent = borrowed(films, known, others)[number]
            if lent is not None:
                found[name].append(_rms_px(_centres(session, own), _centres(session, lent)))
    return {name: _spread(off_px) for name, off_px in found.items()}


def read_rows(films: Sequence[Seen], references: Sequence[FreeFrame | None]) -> dict[str, Any]:
    """Return how many frames are read against their film's reference, and which are refused, by reference.

    A film with neither a free frame nor one to borrow is read against the first frame that was looked at.
    """
    counts = {name: Counter[str]() for name in ("own", "borrowed", "first_frame")}
    refused: list[str] = []
    for number, seen in enumerate(tqdm(films, desc="reading", unit="film")):
        reference = references[number]
        if reference is None:
            name, source, frame = "first_frame", seen, seen.markers.numbers[0]
        else:
            name = "own" if reference.film == number else "borrowed"
            source = films[reference.film]
            frame = source.markers.numbers[reference.frame]
        canonicalizer = Canonicalizer(SENSOR)
        canonicalizer.set_reference(next(islice(film_frames(source.path), frame, None)))
        lost = 0
        for at, raw in islice(enumerate(film_frames(seen.path)), SETTLE, None, STEP):
            counts[name]["frames"] += 1
            try:
                canonicalizer.marker_image(raw)
            except SensorError as error:
                counts[name]["refused"] += 1
                refused.append(f"{seen.trial}/{seen.path.name}, frame {at}, {name}: {error}")
                continue
            match = canonicalizer.match
            lost += match is not None and match.lost >= WARN_SHARE * (match.matched + match.lost)
        counts[name]["some_markers_lost"] += lost
    return {**{name: dict(count) for name, count in counts.items()}, "refusals": refused}


def mount_rows(films: Sequence[Seen]) -> dict[str, dict[str, int]]:
    """Return object → how its grasps say that the left sensor is mounted against the right one.

    The markers' mean motion over the whole film; no reference is needed. Sealed objects are left out.
    """
    found: dict[str, Counter[str]] = {}
    for left, right in zip(films[::2], films[1::2], strict=True):
        held = left.trial.object_name
        if held in SEALED:
            continue
        first, second = mean_motion(left.markers), mean_motion(right.markers)
        both = sorted(first.keys() & second.keys())
        read = np.stack([first[number] for number in both])
        # canonical: the right finger's is mirrored
        known = np.stack([second[number] for number in both]) * (-1, 1)
        found.setdefault(held, Counter())[mount_relation(read, known).mount] += 1
    return {held: dict(votes) for held, votes in sorted(found.items())}


def mean_motion(markers: FilmMarkers) -> dict[int, np.ndarray]:
    """Return frame → mean motion (2,) px of the markers since the frame that shows most of them."""
    base = max(markers.centres_px, key=len)
    reach_px = REACH * spacing(base)
    moved: dict[int, np.ndarray] = {}
    for number, centres_px in zip(markers.numbers, markers.centres_px, strict=True):
        distance, nearest = cKDTree(centres_px).query(base)
        is_near = distance < reach_px
        moved[number] = (centres_px[nearest] - base)[is_near].mean(axis=0)
    return moved


def placed(pattern_px: np.ndarray, centres_px: np.ndarray) -> np.ndarray:
    """Return where a frame shows a pattern's (M, 2) markers, laid on it by a similarity; NaN where one is missing."""
    moved = centres_px.astype(np.float64)
    tree, reach_px = cKDTree(pattern_px), REACH * spacing(pattern_px)
    for _ in range(ROUNDS):
        distance, nearest = tree.query(moved)
        near = distance < reach_px
        matrix, _ = cv2.estimateAffinePartial2D(centres_px[near], pattern_px[nearest[near]])
        moved = centres_px @ matrix[:, :2].T + matrix[:, 2]
    places = np.full(pattern_px.shape, np.nan)
    places[nearest[near]] = moved[near]
    return places


def _mean(places_px: np.ndarray) -> np.ndarray:
    """Return the mean pattern (M, 2) of (films, M, 2); NaN where no film shows a marker."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmean(places_px, axis=0)


def _apart_px(first: np.ndarray, second: np.ndarray) -> float:
    both = np.isfinite(first[:, 0]) & np.isfinite(second[:, 0])
    return _rms_px(second[both], placed(second[both], first[both]))


def _rms_px(first: np.ndarray, second: np.ndarray) -> float:
    """Return the rms distance of (M, 2) points from the nearest of the others', NaN left out."""
    seen = second[np.isfinite(second[:, 0])]
    distance = cKDTree(first).query(seen)[0]
    near = distance < REACH * spacing(first)
    return float(np.sqrt((distance[near] ** 2).mean()))


def _centres(session: Sequence[Film], frame: FreeFrame) -> np.ndarray:
    return session[frame.film].centres_px[frame.frame]


def _is_middle(frame: FreeFrame) -> bool:
    """Return whether a free frame is its pad's pattern itself, so that it can't be off it."""
    return frame.off_px < 1e-3


def _spread(values: Sequence[float]) -> dict[str, float]:
    if not values:
        return {}
    median, most, worst = np.percentile(values, [50, 90, 100]).round(3).tolist()
    return {"median": median, "p90": most, "worst": worst}


@command(ReferencesCommand)
def main(config: ReferencesCommand) -> None:
    if not config.grasps:
        raise ContractError(
            expected("grasps", "a folder of films", "none", "Name that of the recordings.")
        )
    one_thread()
    warnings.filterwarnings("ignore", message="camera frame")  # counted
    trials = read_grasps(config.grasps)
    content: dict[str, Any] = {
        "what": "references of real films of two GelSight Minis, by their markers alone"
    }
    for campaign in ("close", "wide"):
        own = [trial for trial in trials if trial.campaign == campaign]
        if own:
            content[campaign] = campaign_rows(own)
            print(f"{campaign}: {content[campaign]}")
    print(f"written to {write_json(Path(config.out), content | provenance())}")


if __name__ == "__main__":
    sys.exit(main())
