"""A recorded episode's pictures, raw touch, forces, latents and events.

Read for a page, a viewer or scores.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import batched
from pathlib import Path

import numpy as np
import torch

from uniforce_cli.touch_view import counts_picture
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.raw_video import raw_path
from uniforce_datasets.source import (
    Episode,
    Source,
    VideoSpan,
    episode_frames,
    marker_images,
)
from uniforce_vtla.contracts import FINGERS, TAXEL_SHAPE, Finger
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.evaluation.episode_summary import EpisodeSummary, KeyFrame, find_key_frames
from uniforce_vtla.evaluation.finger_estimates import FingerEstimate, estimate_events
from uniforce_vtla.force_sensor import ForceSensor
from uniforce_vtla.keys import (
    AXES,
    STATE,
    TACTILE_KEYS,
    counts_key,
    sensor_key,
    truth_wrench_key,
)
from uniforce_vtla.markers.mirror import to_canonical
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer import ForceHead
from uniforce_vtla.tokenizer.force_head import SOURCE

PLACE = [AXES.index(axis) for axis in ("x.pos", "y.pos", "z.pos")]
BATCH = 32  # frames encoded at once
FILM = 12  # pictures in a film strip: square ones fill a line of it
UNKNOWN_FRICTION = (np.inf, np.inf)  # no pad ever reaches its limit: slippage isn't judged


@dataclass(frozen=True, eq=False)
class EpisodeForces:
    """Both fingers over an episode of n frames, and what the robot knew of itself."""

    time_s: np.ndarray  # (n,) since its first frame
    tool_m: np.ndarray  # (n, 3) measured x, y, z
    force_N: np.ndarray  # (n, 2, 3) left, right, canonical frame: estimates
    true_force_N: np.ndarray | None  # the same from the simulator; None for a robot's recording
    # by finger (n, g, g, L): latents as a policy feels them minus free air's, as the sensor sees it
    change: dict[str, np.ndarray]

    def judge(
        self, pad_friction: tuple[float, float]
    ) -> tuple[FingerEstimate, FingerEstimate | None]:
        """Estimate from the fingers, and from true forces where there are any.

        Raises as ``estimate_events``.
        """

        def judged(force_N: np.ndarray) -> FingerEstimate:
            return estimate_events(self.time_s, force_N, self.tool_m, pad_friction)

        return judged(self.force_N), None if self.true_force_N is None else judged(
            self.true_force_N
        )


class RecordingForces:
    """A recorded dataset and what feels it; its numbers are read once for all episodes.

    It is checked as ``verify`` says. Raises DatasetError: a dataset that can't be read, or lacks a
    finger.
    """

    def __init__(
        self, root: str | Path, sensors: dict[Finger, ForceSensor], verify: str = "quick"
    ) -> None:
        self.source = check_dataset(root, verify)
        if self.source.fingers != FINGERS:
            do = "Record marker images of both fingers."
            raise DatasetError(expected(str(root), f"fingers {FINGERS}", self.source.fingers, do))
        self.sensors = sensors
        state = self.source.columns((STATE,))[STATE]
        self._places_m = state[:, PLACE].astype(np.float64)  # (N, 3)
        self._true_N: np.ndarray | None = None  # (N, 2, 3); a robot's recording has none
        truth = tuple(map(truth_wrench_key, FINGERS))
        if set(truth) <= self.source.features.keys():
            wrenches = self.source.columns(truth)
            forces_N = [wrenches[key][:, :3] for key in truth]
            self._true_N = np.stack(forces_N, axis=1).astype(np.float64)

    def read(self, episode: Episode) -> EpisodeForces:
        """Return an episode's forces; raise DatasetError where its videos can't be read."""
        rows = slice(episode.start, episode.start + episode.length)
        forces_N = []
        change: dict[str, np.ndarray] = {}
        for finger in FINGERS:
            force_N, change[finger] = self._read_finger(episode, finger)
            forces_N.append(force_N)
        return EpisodeForces(
            time_s=np.arange(episode.length) / self.source.fps,
            tool_m=self._places_m[rows],
            force_N=np.stack(forces_N, axis=1),
            true_force_N=None if self._true_N is None else self._true_N[rows],
            change=change,
        )

    def _read_finger(self, episode: Episode, finger: Finger) -> tuple[np.ndarray, np.ndarray]:
        """Return (n, 3) N of one finger, canonical frame, and (n, g, g, L) change of latents."""
        sensor = self.sensors[finger]
        if sensor.calibration is not None:
            sensor.calibration.check_fits(worn(self.source, episode, finger), finger)
        reference, current = marker_images(episode, self.source.fps, finger)
        latents = []
        for images in batched(current, BATCH):
            latents.append(sensor.encode(reference, np.stack(images)))  # (B, K, L)
        latent = torch.cat(latents)  # (n, K, L)
        force_N = sensor.newtons(latent).double().numpy()
        change = latent - sensor.encode(reference, reference[None])
        maps = change.unflatten(1, (sensor.grid, sensor.grid)).movedim(-1, 1)  # (n, L, g, g)
        # undoes the encoder's mirror: its own inverse
        return force_N, to_canonical(maps, finger).movedim(1, -1).numpy()


def finger_sensors(
    head: str = SOURCE, tokenizer: str = "", left_calibration: str = "", right_calibration: str = ""
) -> dict[Finger, ForceSensor]:
    """Return what reads recorded marker images: as a policy feels them.

    Args:
        head: sensor kind whose force head reads newtons, or the folder of a head.
        tokenizer: a shipped size, or a folder; "" for the shipped one.
        left_calibration: folder of `uniforce calibrate` for the left finger's sensor; "" for none.
        right_calibration: the same for the right finger's.

    Raises CheckpointError: a tokenizer, head or calibration that isn't there or doesn't fit.
    """
    reads = ForceHead.from_pretrained(path=head) if Path(head).is_dir() else head
    calibrations: dict[Finger, str] = {"left": left_calibration, "right": right_calibration}
    sensors: dict[Finger, ForceSensor] = {}
    for finger, calibration in calibrations.items():
        sensors[finger] = ForceSensor(
            "", finger, calibration=calibration or None, tokenizer=tokenizer or None, head=reads
        )
    return sensors


def frames(source: Source, episode: Episode, key: str) -> Iterator[np.ndarray]:
    """Return an episode's frames of a video key, (H, W, 3) uint8 RGB.

    Raise DatasetError where they are truncated.
    """
    return episode_frames(episode.videos[key], episode.length, source.fps)


def cameras(source: Source) -> dict[str, str]:
    """Return key by name of every recorded video that is no marker image: the scene cameras."""
    videos = [key for key, feature in source.features.items() if feature["dtype"] == "video"]
    return {
        key.removeprefix("observation.images."): key for key in videos if key not in TACTILE_KEYS
    }


def worn(source: Source, episode: Episode, finger: Finger) -> str:
    """Return the name of the sensor on a finger.

    Raise DatasetError where the dataset names none we know.
    """
    key = sensor_key(finger)
    names = list_sensors()
    if key not in source.features:
        raise DatasetError(
            expected(str(source.root), key, "no such column", "Record it with this version.")
        )
    index = int(source.columns((key,))[key][episode.start])
    if not 0 <= index < len(names):
        raise DatasetError(
            expected(f"{key} in {source.root}", " | ".join(names), index, "Restore it.")
        )
    return names[index]


def raw_touch(source: Source, episode: Episode, finger: Finger) -> Iterator[np.ndarray] | None:
    """Return an episode's raw frames, (H, W, 3) uint8 RGB each; None where none were kept.

    Taxels are drawn as the change of their normal counts since the episode's first frame, which is
    in free air.

    Raises DatasetError: (when read) frames that are missing or truncated.
    """
    if counts_key(finger) in source.features:
        counts = source.columns((counts_key(finger),))[counts_key(finger)]
        rows = counts[episode.start : episode.start + episode.length].astype(np.int64)
        return map(counts_picture, (rows - rows[0]).reshape(episode.length, *TAXEL_SHAPE))
    file = raw_path(source.root, finger, episode.index)
    if not file.is_file():
        return None
    return episode_frames(VideoSpan(file, 0.0), episode.length, source.fps)


def summarise_episode(
    recording: RecordingForces,
    episode: Episode,
    friction: tuple[float, float] | None,
    title: str,
) -> EpisodeSummary:
    """Return what a page or viewer shows of an episode.

    Raises DatasetError: a video that is missing or truncated.
    """
    source = recording.source
    forces = recording.read(episode)
    note = ""
    found: FingerEstimate | None = None
    truth: FingerEstimate | None = None
    try:
        found, truth = forces.judge(friction or UNKNOWN_FRICTION)
    except DatasetError as error:  # it can still be looked at; the sheet says why it isn't judged
        note = str(error)
    # simulated: events by the truth
    known_N = forces.force_N if forces.true_force_N is None else forces.true_force_N
    named = find_key_frames(known_N, forces.tool_m[:, 2])
    # middle of each picture
    film = ((np.arange(FILM) + 0.5) / FILM * episode.length).astype(int).tolist()
    films = {}
    for name, key in cameras(source).items():
        films[name] = _chosen(frames(source, episode, key), film)
    return EpisodeSummary(
        title=title,
        time_s=forces.time_s,
        films=films,
        force_N=forces.force_N,
        true_force_N=forces.true_force_N,
        change=forces.change,
        key_frames=tuple(KeyFrame(name, frame) for name, frame in named.items()),
        found=found,
        truth=truth,
        judges_slip=friction is not None,
        note=note,
    )


def _chosen(pictures: Iterator[np.ndarray], wanted: list[int]) -> list[np.ndarray]:
    """Return the frames of these numbers; one that is wanted twice comes twice."""
    found = {number: frame for number, frame in enumerate(pictures) if number in wanted}
    return [found[number] for number in wanted]
