"""Kinds of damage to a recorded dataset and to a training view, each a small function on a copy."""

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.trust.injuries import Damage, cut, edit_json, flip_bit, overwrite, swap
from uniforce_datasets.cards import card_path
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.raw_video import raw_path
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.synthetic import FPS, BlockMeans, dots, synthetic_frame
from uniforce_datasets.training_view import TrainingView, build_view
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.file_hashes import HASHES
from uniforce_vtla.keys import ACTION, STATE, SUCCESS, camera_key, sensor_key, tactile_key

EPISODES, FRAMES = 3, 12
RAW_SHAPE = (48, 64, 3)
HIT = 1  # the episode that is damaged
SECTION = range(5, 8)  # of its frames
LEFT, REFERENCE = tactile_key("left"), tactile_key("left", reference=True)
Change = Callable[[int, np.ndarray], np.ndarray | None]


def record_whole(folder: Path) -> dict[str, Path]:
    """Record a small dataset with raw frames and cards, all pictures unlike, and build its view."""
    root, rng = folder / "dataset", np.random.default_rng(0)
    shapes = dict.fromkeys(FINGERS, RAW_SHAPE)
    with EpisodeRecorder(
        root, "local/whole", "gelsight", "tactip", FPS, raw_shapes=shapes
    ) as recorder:
        for episode in range(EPISODES):
            for step in range(FRAMES):
                raw = {finger: rng.integers(0, 255, RAW_SHAPE, np.uint8) for finger in FINGERS}
                recorder.add(_frame(episode, step, rng), f"wipe board {episode}", raw)
            recorder.save(True, "success", seed=episode, card={"label": "success"})
    view = build_view(root, folder / "view", image_side=16, encoder=BlockMeans())
    return {"dataset": root, "view": view}


def _frame(episode: int, step: int, rng: np.random.Generator) -> dict[str, Any]:
    frame = synthetic_frame(step + 7 * episode, rng)
    for number, finger in enumerate(FINGERS):
        at_rest = 3 * episode + 11 * number
        frame[tactile_key(finger, reference=True)] = dots(at_rest)
        frame[tactile_key(finger)] = dots(at_rest + 20 * np.sin(step / 5 + episode))
    return frame


# --- files and what is in them ---


def video(root: Path, key: str = LEFT, episode: int = HIT) -> Path:
    return root / "videos" / key / "chunk-000" / f"file-{episode:03d}.mp4"


def data(root: Path, episode: int = HIT) -> Path:
    return root / "data" / "chunk-000" / f"file-{episode:03d}.parquet"


def encode_again(file: Path, change: Change) -> None:
    """Decode a video, change its frames (None leaves one out), and encode it without loss."""
    with av.open(str(file)) as source:
        frames = [frame.to_ndarray(format="rgb24") for frame in source.decode(video=0)]
    changed = [
        new for number, frame in enumerate(frames) if (new := change(number, frame)) is not None
    ]
    with av.open(str(file), "w") as target:
        stream = target.add_stream(
            "h264", FPS, options={"crf": "0", "preset": "ultrafast", "g": "15"}
        )
        stream.height, stream.width = changed[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for frame in changed:
            target.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        target.mux(stream.encode())


def blurred(number: int, frame: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(frame, (5, 5), 0) if number in SECTION else frame


def coloured(number: int, frame: np.ndarray) -> np.ndarray:
    return frame * np.array([number not in SECTION, 1, 1], np.uint8)


def moved(number: int, frame: np.ndarray) -> np.ndarray:
    return np.roll(frame, 6, axis=1) if number >= SECTION.start else frame


def set_value(file: Path, column: str, value: float, row: int = SECTION.start) -> None:
    table = pq.read_table(file)
    values = table[column].to_pylist()
    values[row] = [value, *values[row][1:]] if isinstance(values[row], list) else value
    index = table.column_names.index(column)
    field = table.schema.field(column)
    pq.write_table(table.set_column(index, field, pa.array(values, field.type)), file)


def shorten(file: Path) -> None:
    table = pq.read_table(file)
    pq.write_table(table.slice(0, len(table) - 1), file)


def edit_array(file: Path) -> None:
    values = np.load(file)
    values.flat[values.size // 2] += 1
    np.save(file, values)


def stats(root: Path) -> Path:
    return root / "meta" / "stats.json"


_dataset = partial(
    Damage, load=check_dataset, of="dataset", said=f"episode {HIT}", error=DatasetError
)
_view = partial(
    Damage,
    load=lambda copy, verify: TrainingView(copy, verify=verify),
    of="view",
    error=DatasetError,
)

VIDEO_DAMAGES = (
    _dataset("bytes of a tactile video overwritten", lambda r: overwrite(video(r), 0.8, bytes(64))),
    _dataset(
        "one bit of a camera video flipped", lambda r: flip_bit(video(r, camera_key("front")))
    ),
    _dataset("tactile video truncated", lambda r: cut(video(r))),
    _dataset("tactile video missing", lambda r: video(r).unlink()),
    _dataset(
        "another finger's reference",
        lambda r: shutil.copy(video(r, tactile_key("right", reference=True)), video(r, REFERENCE)),
    ),
    _dataset(
        "reference of another episode",
        lambda r: shutil.copy(video(r, REFERENCE, 2), video(r, REFERENCE)),
    ),
    _dataset(
        "tactile videos of two episodes exchanged", lambda r: swap(video(r), video(r, LEFT, 2))
    ),
    _dataset("left and right exchanged", lambda r: swap(video(r), video(r, tactile_key("right")))),
    _dataset("lossy section in the middle", lambda r: encode_again(video(r), blurred)),
    _dataset("lossy section, no hashes", lambda r: encode_again(video(r), blurred), hashed=False),
    _dataset(
        "coloured section, no hashes", lambda r: encode_again(video(r), coloured), hashed=False
    ),
    _dataset(
        "reference moves, no hashes",
        lambda r: encode_again(video(r, REFERENCE), moved),
        hashed=False,
    ),
    _dataset(
        "a frame missing, no hashes",
        lambda r: encode_again(video(r), lambda n, frame: None if n == 3 else frame),
        hashed=False,
    ),
    _dataset(
        "raw frames of another episode",
        lambda r: shutil.copy(raw_path(r, "left", 2), raw_path(r, "left", HIT)),
    ),
    _dataset("raw frames missing", lambda r: raw_path(r, "right", HIT).unlink()),
)
TABLE_DAMAGES = (
    _dataset("NaN in the state", lambda r: set_value(data(r), STATE, np.nan)),
    _dataset(
        "NaN in the state, no hashes", lambda r: set_value(data(r), STATE, np.nan), hashed=False
    ),
    _dataset(
        "infinite action, no hashes", lambda r: set_value(data(r), ACTION, np.inf), hashed=False
    ),
    _dataset("an action changed", lambda r: set_value(data(r), ACTION, 0.25)),
    _dataset(
        "a time changed, no hashes", lambda r: set_value(data(r), "timestamp", 0.1), hashed=False
    ),
    _dataset(
        "frame of another episode, no hashes",
        lambda r: set_value(data(r), "episode_index", 2),
        hashed=False,
    ),
    _dataset("an aborted episode called a success", lambda r: set_value(data(r), SUCCESS, 0.0)),
    _dataset("another sensor named", lambda r: set_value(data(r), sensor_key("left"), 2)),
    _dataset("a row missing", lambda r: shorten(data(r))),
    _dataset("data files exchanged", lambda r: swap(data(r), data(r, 2))),
    _dataset("bytes of a data file overwritten", lambda r: overwrite(data(r), 0.3, bytes(64))),
)
META_DAMAGES = (
    _dataset(
        "statistics changed",
        lambda r: edit_json(stats(r), lambda s: s[STATE].update(q01=[0] * 5)),
        said="stats",
    ),
    _dataset("statistics missing", lambda r: stats(r).unlink(), said="stats.json"),
    _dataset(
        "another rate",
        lambda r: edit_json(r / "meta/info.json", lambda i: i.update(fps=60)),
        said="info",
    ),
    _dataset("tasks cut", lambda r: cut(r / "meta/tasks.parquet"), said="tasks"),
    _dataset(
        "length of an episode changed",
        lambda r: set_value(
            r / "meta/episodes/chunk-000/file-001.parquet", "length", FRAMES - 1, 0
        ),
    ),
    _dataset(
        "card changed",
        lambda r: edit_json(card_path(r, HIT), lambda card: card.update(label="failed")),
    ),
    _dataset("card missing", lambda r: card_path(r, HIT).unlink()),
    _dataset("a file added", lambda r: shutil.copy(data(r), data(r, 7)), said="file-007.parquet"),
    _dataset("hashes cut", lambda r: cut(r / HASHES), said=HASHES),
    _dataset(
        "a hash removed",
        lambda r: edit_json(r / HASHES, lambda h: h.pop(str(video(r).relative_to(r)))),
        said="file-001.mp4",
    ),
)
VIEW_DAMAGES = (
    _view("a latent changed", lambda r: edit_array(r / "latent_left.npy"), said="latent_left.npy"),
    _view("an action changed", lambda r: edit_array(r / f"{ACTION}.npy"), said=f"{ACTION}.npy"),
    _view(
        "a picture overwritten", lambda r: overwrite(r / "front.npy", 0.5, b"x"), said="front.npy"
    ),
    _view(
        "fingers exchanged",
        lambda r: swap(r / "latent_left.npy", r / "latent_right.npy"),
        said="latent_",
    ),
    _view(
        "another tokenizer named",
        lambda r: edit_json(r / "uniforce_view.json", lambda v: v.update(tokenizer_hash="0" * 64)),
        said="uniforce_view.json",
    ),
)
DATASET_DAMAGES = (*VIDEO_DAMAGES, *TABLE_DAMAGES, *META_DAMAGES, *VIEW_DAMAGES)
