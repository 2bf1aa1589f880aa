"""Statistics of state and action over all frames at once.

LeRobot 0.6.1 averages the quantiles of the episodes: ten episodes that together cover 0…10 get q01 / q99 = 4.5 / 5.5
instead of 0.1 / 9.9, and a quantile-normalised policy then trains on targets far outside [−1, 1].
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import ACTION, STATE

QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
POOLED_KEYS = (STATE, ACTION)


def pooled_stats(values: np.ndarray) -> dict[str, list]:
    """Return min, max, mean, std, count and q01…q99 of (N, D) values, per column."""
    values = values.astype(np.float64)
    stats = {
        "min": values.min(0),
        "max": values.max(0),
        "mean": values.mean(0),
        "std": values.std(0),
        "count": np.array([len(values)]),
    }
    quantiles = np.quantile(values, QUANTILES, axis=0)
    stats |= {f"q{round(q * 100):02d}": row for q, row in zip(QUANTILES, quantiles, strict=True)}
    return {name: value.tolist() for name, value in stats.items()}


def read_columns(root: Path, keys: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Read (N, D) or (N,) columns of every data file, in frame order.

    Raises:
        DatasetError: no data file, or one that can't be read.
    """
    files = sorted((root / "data").rglob("*.parquet"))
    if not files:
        raise DatasetError(expected(str(root), "data/**/*.parquet", "none", "Record episodes first."))
    table = pa.concat_tables([_read(file, keys) for file in files])
    return {key: np.array(table[key].to_pylist()) for key in keys}


def _read(file: Path, keys: tuple[str, ...]) -> pa.Table:
    try:
        return pq.read_table(file, columns=list(keys)).replace_schema_metadata(None)
    except (pa.ArrowInvalid, OSError) as error:
        raise DatasetError(
            expected(
                str(file), "a whole parquet file", error, "It is truncated: restore it or delete the episode."
            )
        ) from error


def write_pooled_stats(root: str | Path) -> None:
    """Replace the statistics of state and action in ``meta/stats.json`` by pooled ones."""
    path = Path(root) / "meta" / "stats.json"
    stats = json.loads(path.read_text())
    columns = read_columns(Path(root), POOLED_KEYS)
    stats |= {key: pooled_stats(columns[key]) for key in POOLED_KEYS}
    fresh = path.with_suffix(".json.new")
    fresh.write_text(json.dumps(stats, indent=4))
    os.replace(fresh, path)
