"""Grasps of two GelSight Minis, as amitparag/Incipient-Slip-Detection stores them (BSD-2).

``docs/franka-servo/datasets`` holds ``[SET/]OBJECT/exp_num_N/{camera_0,camera_2}.avi``: one film a
finger, 320×240 at 25 Hz. The robot grasps, lifts and shakes an object. The hand closes by width;
force isn't recorded. Many trials are stored in several folders, so duplicates are found by the hash
of their films. Two campaigns used different crops: all films of the wide one have 450 frames, and
no film of the close one has.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from benchmarks.real.films import opened_film
from uniforce_datasets.dataset_info import inside
from uniforce_datasets.readers.files import existing_folder, find, read_bytes
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import DatasetError, expected

# assumed; the authors don't say
FILMS: dict[Finger, str] = {"left": "camera_0.avi", "right": "camera_2.avi"}
SLIPPED = "slip.txt"  # an empty file beside the films of a trial whose object slipped
WIDE_FRAMES = 450
FIRST_CHOICE = "base_data_for"  # of several copies: its folders name every object in one way
Campaign = Literal["wide", "close"]


@dataclass(frozen=True)
class GraspTrial:
    """One grasp, filmed by both fingers."""

    object_name: str
    name: str  # its folder within the data set
    campaign: Campaign
    films: dict[Finger, Path]
    slipped: bool

    def __str__(self) -> str:
        return self.name


def read_grasps(folder: str | Path) -> list[GraspTrial]:
    """Return every trial once, sorted by name.

    Raises DatasetError: no trial in the folder, a trial of which a film is missing, or one that
    can't be opened.
    """
    root = existing_folder(folder)
    first: set[Path] = set()
    others: set[Path] = set()
    for name in FILMS.values():
        for film in find(root, f"*/*/{name}"):
            is_first = str(film.relative_to(root)).startswith(FIRST_CHOICE)
            (first if is_first else others).add(film.parent)
    kept: dict[str, GraspTrial] = {}
    for path in [*sorted(first), *sorted(others)]:
        content = _content(path, root)
        if content not in kept:
            kept[content] = _trial(path, root)
    if not kept:
        wanted = f"OBJECT/exp_num_N/{FILMS['left']}"
        do = "Give docs/franka-servo/datasets of the repository."
        raise DatasetError(expected(str(root), wanted, "none", do))
    return sorted(kept.values(), key=str)


def _content(trial: Path, root: Path) -> str:
    digest = hashlib.sha256()
    for finger in FINGERS:
        film = trial / FILMS[finger]
        if not film.is_file():
            do = "Copy the trial again, or leave it out."
            raise DatasetError(
                expected(str(trial), f"a film of each finger, {FILMS}", f"no {film.name}", do)
            )
        digest.update(read_bytes(inside(root, film)))
    return digest.hexdigest()


def _trial(path: Path, root: Path) -> GraspTrial:
    films = {finger: path / name for finger, name in FILMS.items()}
    with opened_film(films["left"]) as film:
        frames = sum(packet.size > 0 for packet in film.demux(video=0))
    return GraspTrial(
        object_name=path.parent.name,
        name=str(path.relative_to(root)),
        campaign="wide" if frames == WIDE_FRAMES else "close",
        films=films,
        slipped=(path / SLIPPED).is_file(),
    )
