"""Agreement of two real GelSight Minis: both fingers of a grasp feel the same normal force.

The formula was fixed before any reading was scored: the relative error of a trial is
mean |fz_a − fz_b| over mean (fz_a + fz_b) / 2, in contact; a set's error is the median over trials.
Contact is defined without the tokenizer, by the shading of the gel. Intervals come from a
bootstrap over objects, since trials of one object resemble each other.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from tqdm import tqdm

from benchmarks.real.film_markers import read_markers
from benchmarks.real.films import film_frames
from benchmarks.real.free_frame import Film, FreeFrame, borrowed, pads
from benchmarks.real.gelsight_grasps import GraspTrial
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import SensorError
from uniforce_vtla.markers import Canonicalizer

SENSOR = "gelsight"
# Objects of base_data_for_validation. A trial of 2026-11-28 looked at them once.
SEEN = (
    "artificial_apple",
    "plastic_pyramid",
    "plier",
    "rubic_cube",
    "tin_box",
    "usb_hub",
    "walnut",
    "wooden_giraffe",
)
# The first six of the other objects by SHA-256 of their names. Scored once, when the tokenizer is
# frozen. Their markers helped to find the pads' free frames; no force was read.
SEALED = (
    "rubber_hand",
    "bag_straws",
    "rubber_salmon_fillet",
    "nylon_thread",
    "screw_driver_red",
    "cellotape",
)
BLUR_px = 10.0  # hides the markers, at 320×240
# Grey levels: free frames differ by up to 1, contacts by 3 and more. Chosen on eight films of the
# close campaign, three of them of seen objects, none of a sealed one.
SHADED = 2.5
SHADED_PERCENTILE = 95
FEWEST_FRAMES = 8  # in contact, or a trial isn't scored
DRAWS = 2000  # of the bootstrap
CHANCE = "chance"
BORROWED = ", borrowed"  # behind the name of a group whose references come from other films

# reference (480, 640), current (T, 480, 640) marker images, finger → (T,) normal force
Reader = Callable[[np.ndarray, np.ndarray, Finger], np.ndarray]


@dataclass(frozen=True)
class Grasp:
    """Frames of one trial in which both fingers are in contact."""

    held: str
    # of trials that are scored together: the campaign, and whether a reference is borrowed
    group: str
    reference: dict[Finger, np.ndarray]  # (480, 640) uint8 marker image
    current: dict[Finger, np.ndarray]  # (T, 480, 640)


@dataclass(frozen=True)
class Films:
    """Frames of one finger's camera, trial by trial."""

    frames: list[list[np.ndarray]]  # (H, W, 3) uint8 each
    free: list[FreeFrame | None]

    def reference(self, trial: int) -> np.ndarray | None:
        """Return the frame of free air for a trial, None if there is none."""
        free = self.free[trial]
        return None if free is None else self.frames[free.film][free.frame]

    def is_borrowed(self, trial: int) -> bool:
        """Whether a trial's reference is a frame of another film."""
        free = self.free[trial]
        return free is not None and free.film != trial


@dataclass(frozen=True)
class Reading:
    """Normal forces read in one trial, N, at the same moments of contact."""

    held: str
    group: str
    left_N: np.ndarray  # (T,)
    right_N: np.ndarray  # (T,)


@dataclass(frozen=True)
class Score:
    """Agreement of the fingers in one trial."""

    held: str
    group: str
    frames: int
    relative_error: float
    r: float  # within the trial
    mean_N: float  # of both fingers' readings


def shading(frame: np.ndarray, reference: np.ndarray) -> float:
    """Return how much a (H, W, 3) uint8 frame's shading differs from the reference, grey levels.

    The median is taken away: exposure changes the whole picture.
    """
    change = _light(frame) - _light(reference)
    return float(np.percentile(np.abs(change - np.median(change)), SHADED_PERCENTILE))


def _light(frame: np.ndarray) -> np.ndarray:
    grey = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return cv2.GaussianBlur(grey, (0, 0), BLUR_px)


def read_films(trials: Sequence[GraspTrial], finger: Finger, borrow: bool = False) -> Films:
    """Return each trial's frames of a finger, every fifth once exposure holds, and its free air.

    Raises SensorError: a frame whose markers can't be read; the fingers' frames are paired by
    number.
    """
    frames: list[list[np.ndarray]] = []
    films: list[Film] = []
    for trial in trials:
        every = list(film_frames(trial.films[finger]))
        seen = read_markers(every, SENSOR)
        if seen.refused:
            raise SensorError(f"{trial.films[finger]}: {next(iter(seen.refused.values()))}")
        frames.append([every[number] for number in seen.numbers])
        films.append(Film(trial.object_name, seen.centres_px))
    known, free = pads(films)
    return Films(frames, borrowed(films, known, free) if borrow else free)


def in_contact(
    held: str,
    group: str,
    frames: dict[Finger, list[np.ndarray]],
    references: dict[Finger, np.ndarray],
) -> Grasp | None:
    """Return the frames in which both gels are shaded, None if there are too few."""
    chosen = []
    for number, both in enumerate(zip(*(frames[finger] for finger in FINGERS), strict=False)):
        shades = [
            shading(frame, references[finger]) for frame, finger in zip(both, FINGERS, strict=True)
        ]
        if min(shades) > SHADED:
            chosen.append(number)
    if len(chosen) < FEWEST_FRAMES:
        return None
    return drawn_grasp(SENSOR, held, group, frames, references, chosen)


def drawn_grasp(
    sensor: str,
    held: str,
    group: str,
    raw: Mapping[Finger, Sequence[np.ndarray] | np.ndarray],
    references: Mapping[Finger, np.ndarray],
    chosen: Sequence[int],
) -> Grasp:
    """Return the marker images of the chosen raw signals of both fingers, against references."""
    reference: dict[Finger, np.ndarray] = {}
    current: dict[Finger, np.ndarray] = {}
    for finger in FINGERS:
        canonicalizer = Canonicalizer(sensor)
        canonicalizer.set_reference(references[finger])
        reference[finger] = canonicalizer.marker_image(references[finger])
        images = [canonicalizer.marker_image(raw[finger][number]) for number in chosen]
        current[finger] = np.stack(images)  # (T, 480, 640)
    return Grasp(held, group, reference, current)


def read_grasp(grasp: Grasp, read: Reader) -> Reading:
    """Return the normal forces that a reader finds on both fingers."""
    left_N = read(grasp.reference["left"], grasp.current["left"], "left")
    right_N = read(grasp.reference["right"], grasp.current["right"], "right")
    return Reading(grasp.held, grasp.group, left_N, right_N)


def agreement(reading: Reading) -> Score:
    """Return how well the normal forces of the two fingers agree."""
    left_N = reading.left_N
    right_N = reading.right_N
    mean_N = float((left_N + right_N).mean() / 2)
    error = float(np.abs(left_N - right_N).mean() / abs(mean_N))
    r = float(np.corrcoef(left_N, right_N)[0, 1])
    return Score(reading.held, reading.group, len(left_N), error, r, mean_N)


def by_chance(readings: Sequence[Reading]) -> list[Reading]:
    """Return each trial's left finger beside the right one of the next trial of another object."""
    found = []
    for number, reading in enumerate(readings):
        for other in (*readings[number + 1 :], *readings[:number]):
            if other.held != reading.held:
                n = min(len(reading.left_N), len(other.right_N))
                found.append(replace(reading, left_N=reading.left_N[:n], right_N=other.right_N[:n]))
                break
    return found


def summary(scores: Sequence[Score], seed: int = 0) -> dict[str, object]:
    """Return the median error and r over trials, with 95 % intervals by bootstrap over objects."""
    held = np.array([score.held for score in scores])
    of_trials = np.array([[score.relative_error, score.r] for score in scores])  # (n, 2)
    trials = {name: np.flatnonzero(held == name) for name in sorted(set(held.tolist()))}
    objects = list(trials)
    rng = np.random.default_rng(seed)
    medians = []
    for _ in range(DRAWS):
        # all trials of an object are drawn together
        drawn = np.concatenate([trials[name] for name in rng.choice(objects, len(objects))])
        medians.append(np.median(of_trials[drawn], axis=0))
    error, r = np.median(of_trials, axis=0).tolist()
    error_95, r_95 = np.percentile(medians, [2.5, 97.5], axis=0).T.tolist()
    return {
        "objects": len(objects),
        "trials": len(scores),
        "relative_error": error,
        "relative_error_95": error_95,
        "r": r,
        "r_95": r_95,
    }


def find_grasps(trials: Sequence[GraspTrial], borrow: bool = False) -> Iterator[Grasp]:
    """Yield the trials with references and enough contact on both fingers, campaign by campaign.

    Args:
        trials: all that one rig recorded; those of other objects show which markers are free.
        borrow: take references from other films of the same pad where a film shows contact only.
    """
    for campaign in ("close", "wide"):
        own = [trial for trial in trials if trial.campaign == campaign]
        if not own:
            continue
        films = {finger: read_films(own, finger, borrow) for finger in FINGERS}
        for number, trial in enumerate(own):
            references = {}
            frames = {}
            group = campaign
            for finger, of_finger in films.items():
                frames[finger] = of_finger.frames[number]
                frame = of_finger.reference(number)
                if frame is not None:
                    references[finger] = frame
                if of_finger.is_borrowed(number):
                    group = f"{campaign}{BORROWED}"
            if len(references) < len(FINGERS):
                continue
            grasp = in_contact(trial.object_name, group, frames, references)
            if grasp is not None:
                yield grasp


def read_grasps_by(
    grasps: Iterable[Grasp], readers: Mapping[str, Reader]
) -> dict[str, list[Reading]]:
    """Return reader → readings; ``CHANCE``: the first's, of fingers that held two objects."""
    found: dict[str, list[Reading]] = {name: [] for name in readers}
    for grasp in tqdm(grasps, desc="grasps", unit="grasp"):
        for name, read in readers.items():
            found[name].append(read_grasp(grasp, read))
    first = next(iter(readers))
    return found | {CHANCE: by_chance(found[first])}


def by_group(readings: Sequence[Reading]) -> dict[str, object]:
    """Return group of trials → agreement of the fingers."""
    scores: dict[str, list[Score]] = {}
    for reading in sorted(readings, key=lambda reading: reading.group):
        scores.setdefault(reading.group, []).append(agreement(reading))
    return {group: summary(of_group) for group, of_group in scores.items()}
