"""Statistics of state and action over all frames at once.

LeRobot 0.6.1 averages the quantiles of the episodes: ten episodes that together cover 0…10 get
q01 / q99 = 4.5 / 5.5 instead of 0.1 / 9.9, and a quantile-normalised policy then trains on targets
far outside [−1, 1].
"""

import json
import shutil
from pathlib import Path

import numpy as np

from uniforce_datasets.hashes import stage_hashes
from uniforce_datasets.source import read_source
from uniforce_datasets.staging import STAGING, commit
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import ACTION, STATE
from uniforce_vtla.options import absolute

QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
POOLED_KEYS = (STATE, ACTION)


def pooled_stats(values: np.ndarray) -> dict[str, np.ndarray]:
    """Return min, max, mean, std, count and q01…q99 of (N, D) values, per column."""
    values = values.astype(np.float64)
    stats = {
        "min": values.min(0),
        "max": values.max(0),
        "mean": values.mean(0),
        "std": values.std(0),
        "count": np.array([len(values)]),
    }
    for share, row in zip(QUANTILES, np.quantile(values, QUANTILES, axis=0), strict=True):
        stats[f"q{round(share * 100):02d}"] = row
    return stats


def write_pooled_stats(root: str | Path) -> None:
    """Replace the statistics of state and action in ``meta/stats.json`` by pooled ones.

    Statistics and hashes change in one step; no other program may write to the dataset meanwhile.

    Raises DatasetError: the statistics or the columns are damaged.
    """
    root = absolute(root)
    stats = read_object(root / "meta" / "stats.json", DatasetError)
    columns = read_source(root).columns(tuple(key for key in POOLED_KEYS if key in stats))
    for key, values in columns.items():
        stats[key] = {name: value.tolist() for name, value in pooled_stats(values).items()}
    staged = root / STAGING / "meta" / "stats.json"
    try:
        staged.parent.mkdir(parents=True)
        staged.write_text(json.dumps(stats, indent=4))
        stage_hashes(root)
        commit(root)
    finally:
        shutil.rmtree(root / STAGING, ignore_errors=True)  # half a file of a full disk
