"""Plan of a training view: chosen episodes of one or more recorded datasets, and every setting.

``ViewPlan.marker`` becomes ``uniforce_view.json``; ``read_marker`` checks it.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uniforce_datasets.dataset_info import check_links
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.source import Episode, Source
from uniforce_vtla import keys
from uniforce_vtla.contracts import FINGERS, Finger, check_finger
from uniforce_vtla.errors import DatasetError, expected, require_one_of
from uniforce_vtla.json_file import read_object
from uniforce_vtla.sensors import list_sensors

FORMAT = 2  # of the view folder; a view of another format is built anew
# arrays per finger; the last two feed controls
TOUCH_STREAMS = ("latent", "descriptor", "marker_pair")


def touch_stream(name: str, finger: Finger) -> str:
    """Name of a finger's array in a view."""
    return f"{name}_{finger}"


@dataclass(frozen=True)
class EpisodeFacts:
    """Facts of one recorded episode; ``episodes=`` filters see them."""

    source: str
    episode: int
    length: int
    task: str
    success: bool
    outcome: str
    seed: int
    left_sensor: str
    right_sensor: str


@dataclass(frozen=True)
class ViewSettings:
    """Everything that decides a view's content besides the recorded data."""

    image_side: int
    latent_grid: int
    slots: Mapping[str, str]
    tokenizer_hash: str


@dataclass(frozen=True)
class ViewPlan:
    """Chosen episodes in order, where they come from, and the numeric columns of all their frames."""

    settings: ViewSettings
    fps: int
    facts: tuple[EpisodeFacts, ...]
    episodes: tuple[tuple[Source, Episode], ...]
    columns: dict[str, np.ndarray]

    @property
    def num_frames(self) -> int:
        """N, frames of all chosen episodes."""
        return sum(fact.length for fact in self.facts)

    @property
    def starts(self) -> np.ndarray:
        """(E + 1,) first frame of each episode, and N."""
        return np.concatenate([[0], np.cumsum([fact.length for fact in self.facts])]).astype(
            np.int64
        )

    @property
    def marker(self) -> dict[str, Any]:
        """Content of ``uniforce_view.json``."""
        sensors = {
            f: sorted({getattr(fact, f"{f}_sensor") for fact in self.facts}) for f in FINGERS
        }
        return asdict(self.settings) | {
            "format": FORMAT,
            "fps": self.fps,
            "num_frames": self.num_frames,
            "sources": sorted({fact.source for fact in self.facts}),
            "sensors": sensors,
            "wrench": keys.truth_wrench_key(FINGERS[0]) in self.columns,
            "episodes": [asdict(fact) for fact in self.facts],
            "content": self._content(),
        }

    def _content(self) -> str:
        """Hash of settings, episodes and numbers: equal for a view that needs no rebuilding."""
        digest = hashlib.sha256(
            json.dumps([asdict(self.settings), *map(asdict, self.facts)]).encode()
        )
        for key in sorted(self.columns):
            digest.update(np.ascontiguousarray(self.columns[key]).tobytes())
        return digest.hexdigest()


def plan_view(
    roots: Sequence[str | Path],
    settings: ViewSettings,
    wanted: Callable[[EpisodeFacts], bool],
    verify: str = "quick",
) -> ViewPlan:
    """Check the datasets and choose their episodes.

    Raises DatasetError: a broken dataset, different frame rates, a stream missing, no episode chosen; ContractError:
    unknown slots or fingers.
    """
    for slot, finger in settings.slots.items():
        require_one_of("slot", slot, keys.SLOTS, "Write touch0:right.")
        check_finger(finger)
    sources = [check_dataset(root, verify) for root in roots]
    for source in sources:
        _check_streams(source, sources[0].fps)
    truth = all(keys.truth_wrench_key(f) in s.features for s in sources for f in FINGERS)
    chosen = [(s, e, f) for s in sources for e, f in episode_facts(s) if wanted(f)]
    if not chosen:
        do = "Record successful demos, or keep failures."
        raise DatasetError(expected("view", "at least one chosen episode", "none", do))
    facts, episodes = tuple(f for *_, f in chosen), tuple((s, e) for s, e, _ in chosen)
    return ViewPlan(settings, sources[0].fps, facts, episodes, _columns(episodes, truth))


def _check_streams(source: Source, fps: int) -> None:
    needed = [keys.camera_key(c) for c in keys.CAMERAS] + [keys.tactile_key(f) for f in FINGERS]
    missing = [key for key in needed if key not in source.features]
    if missing or source.fps != fps:
        came = f"{source.fps} Hz, without {missing}" if missing else f"{source.fps} Hz"
        raise DatasetError(
            expected(str(source.root), f"{fps} Hz and {needed}", came, "Leave it out.")
        )


def episode_facts(source: Source) -> list[tuple[Episode, EpisodeFacts]]:
    """Return the episodes of a dataset with what is known of each; raises DatasetError: columns are missing."""
    left, right = (keys.sensor_key(f) for f in FINGERS)
    columns = source.columns((keys.SUCCESS, keys.OUTCOME, keys.SEED, left, right))

    def fact(episode: Episode) -> EpisodeFacts:
        first = {key: column[episode.start] for key, column in columns.items()}
        sensors = (list_sensors()[int(first[key])] for key in (left, right))
        success, outcome = bool(first[keys.SUCCESS]), keys.OUTCOME_NAMES[int(first[keys.OUTCOME])]
        head = (str(source.root), episode.index, episode.length, episode.task)
        return EpisodeFacts(*head, success, outcome, int(first[keys.SEED]), *sensors)

    return [(episode, fact(episode)) for episode in source.episodes]


def _columns(episodes: Sequence[tuple[Source, Episode]], truth: bool) -> dict[str, np.ndarray]:
    wanted = (keys.STATE, keys.ACTION, *(keys.truth_wrench_key(f) for f in FINGERS if truth))
    by_root = {source.root: source.columns(wanted) for source, _ in episodes}

    def gather(key: str) -> np.ndarray:
        parts = [by_root[s.root][key][e.start : e.start + e.length] for s, e in episodes]
        return np.concatenate(parts).astype(np.float32)

    return {key: gather(key) for key in wanted}


# --- the facts of a view that was built, checked before any of its arrays is opened

COUNTS = ("image_side", "latent_grid", "fps", "num_frames")
TOUCH = tuple(touch_stream(name, finger) for name in TOUCH_STREAMS for finger in FINGERS)


def read_marker(root: Path) -> dict[str, Any]:
    """Return a view's facts.

    Raises DatasetError: not a whole view of this format, damaged facts, or a link that leads out of the folder.
    """
    file = root / keys.VIEW_MARKER
    if not file.is_file():
        raise DatasetError(
            expected(str(root), keys.VIEW_MARKER, "none", "Build the view with uniforce view.")
        )
    check_links(root, root)
    marker = read_object(file, DatasetError)
    arrays = (*keys.CAMERAS, keys.STATE, keys.ACTION, *TOUCH)
    missing = [name for name in arrays if not (root / f"{name}.npy").is_file()]
    if marker.get("format") != FORMAT or missing:
        came = f"format {marker.get('format')}, missing {missing}"
        raise DatasetError(
            expected(str(root), f"a whole view of format {FORMAT}", came, "Build it again.")
        )
    counted = all(type(marker.get(name)) is int and marker[name] > 0 for name in COUNTS)
    if not (counted and _described(marker) and _filled(marker)):
        raise DatasetError(expected(str(file), "the facts of a view", "others", "Build it again."))
    return marker


def _described(marker: dict[str, Any]) -> bool:
    sensors, slots = marker.get("sensors"), marker.get("slots")
    named = isinstance(sensors, dict) and all(_words(kinds) for kinds in sensors.values())
    filled = isinstance(slots, dict) and _words(list(slots.values()))
    return named and filled and isinstance(marker.get("wrench"), bool)


def _filled(marker: dict[str, Any]) -> bool:
    """Whether these are episodes, and together as long as the view."""
    episodes = marker.get("episodes")
    if not isinstance(episodes, list) or not all(isinstance(e, dict) for e in episodes):
        return False
    lengths = [e.get("length") for e in episodes]
    whole = all(type(length) is int and length > 0 for length in lengths)
    words = [e.get(name) for e in episodes for name in ("task", "left_sensor", "right_sensor")]
    return whole and sum(lengths) == marker["num_frames"] and _words(words)


def _words(values: object) -> bool:
    return isinstance(values, list) and all(isinstance(value, str) for value in values)
