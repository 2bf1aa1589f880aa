"""LeRobot's dataset writer, pointed at the staging folder.

``LeRobotDataset.resume`` reads all episodes' metadata through Hugging Face datasets, about a second
of work per saved episode; a writer needs only where the last one ended.
"""

from operator import itemgetter
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.dataset_writer import DatasetWriter
from lerobot.datasets.io_utils import load_info, load_stats, load_tasks

from uniforce_datasets.dataset_info import parquet_files
from uniforce_datasets.staging import STAGING
from uniforce_datasets.video_encoder import PerKeyEncoder, camera_codec
from uniforce_vtla.errors import DatasetError, expected

# a revision that is no version number: LeRobot then doesn't look for one on the hub
LOCAL = "local"


class StagedMetadata(LeRobotDatasetMetadata):
    """LeRobot's metadata with the last episode's row only."""

    def _load_metadata(self) -> None:
        if not (self.root / "meta" / "info.json").is_file():  # never ask the hub instead
            raise DatasetError(
                expected(str(self.root), "meta/info.json", "none", "Give a dataset's folder.")
            )
        try:
            self.info = load_info(self.root)
            self.stats = load_stats(self.root)
            self.tasks = None
            self.episodes = None
            if self.total_tasks:
                self.tasks = load_tasks(self.root)
            if self.total_episodes:
                self.episodes = [_last_row(self.root, self.video_keys)]
        except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
            do = "Restore it from a copy, or record into a new folder."
            came = f"{type(error).__name__}: {error}"
            raise DatasetError(
                expected(f"{self.root}/meta", "a dataset's metadata", came, do)
            ) from error


def _last_row(root: Path, video_keys: list[str]) -> dict[str, Any]:
    """Return the columns a writer goes on from."""
    columns = ["episode_index", "dataset_to_index"]
    for prefix in ("data", "meta/episodes", *(f"videos/{key}" for key in video_keys)):
        columns += [f"{prefix}/chunk_index", f"{prefix}/file_index"]
    file = parquet_files(root / "meta" / "episodes")[-1]
    rows = pq.ParquetFile(file).read(columns=columns).to_pylist()
    return max(rows, key=itemgetter("episode_index"))


def open_writer(
    root: Path, repo_id: str, fps: int, features: dict[str, dict], queue_frames: int, realtime: bool
) -> DatasetWriter:
    """Return a writer into the staging folder that goes on with the dataset at ``root``."""
    staged = root / STAGING
    if (root / "meta" / "info.json").exists():
        meta = StagedMetadata(repo_id, root, LOCAL)
        (staged / "meta").mkdir(parents=True, exist_ok=True)
        meta.root = staged
    else:
        meta = StagedMetadata.create(repo_id, fps, dict(features), root=staged)
    return DatasetWriter(
        meta=meta,
        root=staged,
        rgb_encoder=camera_codec(),
        depth_encoder=None,
        encoder_threads=1,
        batch_encoding_size=1,
        streaming_encoder=PerKeyEncoder(fps, queue_frames, realtime),
        initial_frames=meta.total_frames,
    )
