"""Plan of a training view: chosen episodes of one or more recorded datasets, and every setting.

``ViewPlan.marker`` becomes ``uniforce_view.json``; ``read_marker`` checks it.
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
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
# array of a view in which instructions change within an episode: (N,) index into its "tasks"
TASK_INDEX = "task_index"


def latent_array(finger: Finger) -> str:
    """Name of the array of a finger's latents in a view."""
    return f"latent_{finger}"


@dataclass(frozen=True)
class EpisodeFacts:
    """Facts of one recorded episode; ``episodes=`` filters see them."""

    source: str
    episode: int
    length: int
    task: str  # the instruction of its first frame
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
    # recorded name of each of the view's cameras that was recorded under another name
    cameras: Mapping[str, str] = field(default_factory=dict)

    def video_key(self, camera: str) -> str:
        """Return the key under which one of the view's cameras was recorded."""
        return keys.camera_key(self.cameras.get(camera, camera))

    @property
    def stored(self) -> dict[str, Any]:
        """Settings as the view stores them; without renamed cameras as earlier versions did."""
        stored = asdict(self)
        if not self.cameras:
            del stored["cameras"]
        return stored


@dataclass(frozen=True)
class ViewPlan:
    """Chosen episodes in order, where they come from, and the numeric columns of all their frames.

    ``tasks`` are the instructions that ``columns[TASK_INDEX]`` counts; empty where each episode
    has one instruction.
    """

    settings: ViewSettings
    fps: int
    facts: tuple[EpisodeFacts, ...]
    episodes: tuple[tuple[Source, Episode], ...]
    columns: dict[str, np.ndarray]
    tasks: tuple[str, ...]

    @property
    def starts(self) -> np.ndarray:
        """(E + 1,) first frame of each episode, and N."""
        return np.cumsum([0, *(fact.length for fact in self.facts)])

    @property
    def num_frames(self) -> int:
        """N, frames of all chosen episodes."""
        return int(self.starts[-1])

    @property
    def marker(self) -> dict[str, Any]:
        """Content of ``uniforce_view.json``."""
        episodes = list(map(asdict, self.facts))
        marker = self.settings.stored | {
            "format": FORMAT,
            "fps": self.fps,
            "num_frames": self.num_frames,
            "sources": sorted({fact.source for fact in self.facts}),
            "sensors": mounted_sensors(episodes),
            "wrench": keys.truth_wrench_key(FINGERS[0]) in self.columns,
            "episodes": episodes,
            "content": self._content(episodes),
        }
        if self.tasks:
            marker["tasks"] = list(self.tasks)
        return marker

    def _content(self, episodes: list[dict[str, Any]]) -> str:
        """Hash of settings, episodes and numbers: equal for a view that needs no rebuilding."""
        content = [self.settings.stored, *episodes, *self.tasks]
        digest = hashlib.sha256(json.dumps(content).encode())
        for key in sorted(self.columns):
            digest.update(np.ascontiguousarray(self.columns[key]).tobytes())
        return digest.hexdigest()


def mounted_sensors(episodes: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Return the names of all sensors that a finger had in some episodes, by finger."""
    mounted: dict[str, list[str]] = {}
    for finger in FINGERS:
        mounted[finger] = sorted({facts[f"{finger}_sensor"] for facts in episodes})
    return mounted


def plan_view(
    roots: Sequence[str | Path],
    settings: ViewSettings,
    wanted: Callable[[EpisodeFacts], bool],
    verify: str = "quick",
) -> ViewPlan:
    """Check the datasets and choose their episodes.

    Raises DatasetError: a broken dataset, different frame rates, a stream missing, no episode
    chosen; ContractError: unknown slots, fingers or cameras.
    """
    for slot, finger in settings.slots.items():
        require_one_of("slot", slot, keys.SLOTS, "Write touch0:right.")
        check_finger(finger)
    for camera in settings.cameras:
        require_one_of("camera", camera, keys.CAMERAS, "Write front:NAME, the recorded one last.")
    facts: list[EpisodeFacts] = []
    episodes: list[tuple[Source, Episode]] = []
    sources = [check_dataset(root, verify) for root in roots]
    for source in sources:
        _check_streams(source, sources[0].fps, settings)
        for episode, fact in episode_facts(source):
            if wanted(fact):
                facts.append(fact)
                episodes.append((source, episode))
    if not facts:
        do = "Record successful demos, or keep failures."
        raise DatasetError(expected("view", "at least one chosen episode", "none", do))
    columns, tasks = _columns(episodes, sources)
    return ViewPlan(settings, sources[0].fps, tuple(facts), tuple(episodes), columns, tasks)


def _check_streams(source: Source, fps: int, settings: ViewSettings) -> None:
    cameras = list(map(settings.video_key, keys.CAMERAS))
    needed = [*cameras, *map(keys.tactile_key, FINGERS)]
    missing = [key for key in needed if key not in source.features]
    if not missing and source.fps == fps:
        return
    came = f"{source.fps} Hz"
    do = "Leave it out."
    if missing:
        came += f", without {missing}"
    if set(missing) & set(cameras):
        recorded = ", ".join(source.cameras) or "none"
        option = "cameras=front:NAME,wrist:NAME"
        do = f"Rename its cameras ({recorded}) with {option}, or leave it out."
    raise DatasetError(expected(str(source.root), f"{fps} Hz and {needed}", came, do))


def episode_facts(source: Source) -> list[tuple[Episode, EpisodeFacts]]:
    """Return the episodes of a dataset with their facts; DatasetError: columns are missing."""
    left_key = keys.sensor_key("left")
    right_key = keys.sensor_key("right")
    columns = source.columns((keys.SUCCESS, keys.OUTCOME, keys.SEED, left_key, right_key))
    instructions = source.instructions()
    sensors = list_sensors()
    found = []
    for episode in source.episodes:
        first = {key: column[episode.start].item() for key, column in columns.items()}
        facts = EpisodeFacts(
            source=str(source.root),
            episode=episode.index,
            length=episode.length,
            task=instructions[episode.start],
            success=bool(first[keys.SUCCESS]),
            outcome=keys.OUTCOME_NAMES[int(first[keys.OUTCOME])],
            seed=int(first[keys.SEED]),
            left_sensor=sensors[int(first[left_key])],
            right_sensor=sensors[int(first[right_key])],
        )
        found.append((episode, facts))
    return found


def _columns(
    episodes: Sequence[tuple[Source, Episode]], sources: Sequence[Source]
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Return columns of all chosen frames, and instructions where they change in an episode."""
    wrenches = tuple(map(keys.truth_wrench_key, FINGERS))
    wanted: tuple[str, ...] = (keys.STATE, keys.ACTION)
    if all(source.features.keys() >= set(wrenches) for source in sources):
        wanted += wrenches
    stored: dict[Path, dict[str, np.ndarray]] = {}
    words: list[np.ndarray] = []
    one_each = True
    parts: dict[str, list[np.ndarray]] = defaultdict(list)
    for source, episode in episodes:
        if source.root not in stored:
            stored[source.root] = source.columns(wanted) | {keys.TASK: source.instructions()}
        columns = stored[source.root]
        words.append(columns[keys.TASK][episode.rows])
        one_each &= len(set(words[-1])) == 1
        for key in wanted:
            parts[key].append(columns[key][episode.rows])
    joined = {key: np.concatenate(blocks).astype(np.float32) for key, blocks in parts.items()}
    if one_each:
        return joined, ()
    tasks, joined[TASK_INDEX] = np.unique(np.concatenate(words), return_inverse=True)
    return joined, tuple(tasks)


# --- the facts of a view that was built, checked before any of its arrays is opened

COUNTS = ("image_side", "latent_grid", "fps", "num_frames")


def read_marker(root: Path) -> dict[str, Any]:
    """Return a view's facts.

    Raises DatasetError: not a whole view of this format, damaged facts, or a link that leads out
    of the folder.
    """
    file = root / keys.VIEW_MARKER
    if not file.is_file():
        raise DatasetError(
            expected(str(root), keys.VIEW_MARKER, "none", "Build the view with uniforce view.")
        )
    check_links(root, root)
    marker = read_object(file, DatasetError)
    arrays = [*keys.CAMERAS, keys.STATE, keys.ACTION, *map(latent_array, FINGERS)]
    if "tasks" in marker:
        arrays.append(TASK_INDEX)
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
    sensors = marker.get("sensors")
    slots = marker.get("slots")
    if not (isinstance(sensors, dict) and isinstance(slots, dict)):
        return False
    lists = [*sensors.values(), list(slots.values()), marker.get("tasks", [])]
    return all(map(_words, lists)) and isinstance(marker.get("wrench"), bool)


def _filled(marker: dict[str, Any]) -> bool:
    """Whether these are episodes, and together as long as the view."""
    episodes = marker.get("episodes")
    if not isinstance(episodes, list):
        return False
    frames = 0
    for facts in episodes:
        if not isinstance(facts, dict):
            return False
        length = facts.get("length")
        words = [facts.get(name) for name in ("task", "left_sensor", "right_sensor")]
        if type(length) is not int or length <= 0 or not _words(words):
            return False
        frames += length
    return frames == marker["num_frames"]


def _words(values: object) -> bool:
    return isinstance(values, list) and all(isinstance(value, str) for value in values)
