"""Free-air references of recorded films: an own frame, a borrowed one, or the reason for none."""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

from tqdm import tqdm

from uniforce_datasets.readers.files import existing_folder
from uniforce_datasets.readers.films import film_frames, find_films
from uniforce_vtla.errors import ContractError, UniForceError, expected
from uniforce_vtla.markers.film_markers import SETTLE, FilmMarkers, read_markers
from uniforce_vtla.markers.free_frame import FEWEST_OBJECTS, Film, borrowed, pads
from uniforce_vtla.sensors import get_sensor


@dataclass(frozen=True)
class FilmReference:
    """Where the reference of a film is."""

    film: str  # within the session's folder
    held: str  # the object
    read: int  # frames
    refused: dict[int, str]  # frame → why it couldn't be read
    why: str = ""  # why there is no reference; empty where there is one
    # film that the reference is a frame of: another one than ``film`` where it is borrowed
    of: str = ""
    frame: int = -1  # in that film, from 0
    # rms over markers, from the frame that most objects of the pad share; 0 for that frame itself
    off_px: float = 0.0
    pad: int = -1  # which of the session's

    @property
    def is_borrowed(self) -> bool:
        """Whether the reference comes from another film."""
        return bool(self.of) and self.of != self.film


def film_references(folder: str | Path, sensor: str, borrow: bool = False) -> list[FilmReference]:
    """Return the reference of every film of one session, sorted by film.

    Args:
        folder: films below a folder for each object; see ``find_films``. The films may show several
            pads.
        sensor: the camera sensor that was filmed.
        borrow: give a film without a free frame the one of another film of its pad. Pads are
            mounted anew between films, so it may lie a few pixels off.

    Raises ContractError: no camera sensor; DatasetError: no film in the folder. A film that can't
    be read, or has frames of another size than most, says so in ``why``.
    """
    if get_sensor(sensor).signal != "camera":
        raise ContractError(
            expected("sensor", "a camera sensor", sensor, "Counts of taxels are not filmed.")
        )
    root = existing_folder(folder)
    found: dict[Path, FilmReference] = {}
    markers: dict[Path, FilmMarkers] = {}
    for path, held in tqdm(find_films(root).items(), desc="films", unit="film"):
        name = path.relative_to(root).as_posix()
        try:
            seen = read_markers(film_frames(path), sensor)
        except UniForceError as error:
            found[path] = FilmReference(name, held, 0, {}, why=str(error))
            continue
        why = _unread(name, seen)
        found[path] = FilmReference(name, held, len(seen.numbers), seen.refused, why)
        if not why:
            markers[path] = seen
    session = _of_one_size(found, markers)
    if session:
        _place(found, session, markers, borrow)
    return list(found.values())


def _unread(name: str, seen: FilmMarkers) -> str:
    """Return why none of a film's frames can be used; "" where some can."""
    if seen.numbers:
        return ""
    if not seen.refused:
        return expected(name, f"more than {SETTLE} frames", "fewer", "Record a little longer.")
    number, why = next(iter(seen.refused.items()))
    return f"{name}: none of {len(seen.refused)} frames can be read; frame {number}: {why}"


def _of_one_size(found: dict[Path, FilmReference], markers: dict[Path, FilmMarkers]) -> list[Path]:
    """Return the films of the commonest frame size; set ``why`` of the others."""
    if not markers:
        return []
    [(usual, _)] = Counter(seen.shape for seen in markers.values()).most_common(1)
    session = []
    for path, seen in markers.items():
        if seen.shape == usual:
            session.append(path)
            continue
        do = "Films of another camera setting are another session: "
        do += "put them in a folder of their own."
        why = expected(found[path].film, usual, seen.shape, do)
        found[path] = replace(found[path], why=why)
    return session


def _place(
    found: dict[Path, FilmReference],
    session: list[Path],
    markers: dict[Path, FilmMarkers],
    borrow: bool,
) -> None:
    """Put the references of a session's films in."""
    films = [Film(found[path].held, markers[path].centres_px) for path in session]
    known, taken = pads(films)
    if borrow:
        taken = borrowed(films, known, taken)
    pad_of = dict.fromkeys(range(len(films)), -1)
    for number, pad in enumerate(known):
        pad_of |= dict.fromkeys(pad.films, number)
    for number, path in enumerate(session):
        own = found[path]
        reference = taken[number]
        if reference is None:
            why = _missing(own.film, pad_of[number])
            found[path] = replace(own, why=why, pad=pad_of[number])
            continue
        source = session[reference.film]
        frame = markers[source].numbers[reference.frame]
        found[path] = replace(
            own, of=found[source].film, frame=frame, off_px=reference.off_px, pad=reference.pad
        )


def _missing(name: str, pad: int) -> str:
    if pad < 0:
        wanted = f"a free frame, in which {FEWEST_OBJECTS} objects show the same markers"
        do = "Begin each film in free air, and film more objects with this pad."
        return expected(name, wanted, "none", do)
    do = "It shows contact only: begin in free air, or borrow=true takes another film's."
    return expected(name, f"a free frame of pad {pad}", "none", do)
