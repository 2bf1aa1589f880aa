import json
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_datasets.pooled_quantiles import POOLED_KEYS, pooled_stats
from uniforce_datasets.source import read_source


def test_recorded_statistics_are_pooled(demos: Path) -> None:
    stats = json.loads((demos / "meta" / "stats.json").read_text())
    for key, values in read_source(demos).columns(POOLED_KEYS).items():
        assert values.shape == (60, 5)
        for quantile in (1, 10, 50, 90, 99):
            wanted = np.quantile(values.astype(np.float64), quantile / 100, axis=0)
            np.testing.assert_allclose(stats[key][f"q{quantile:02d}"], wanted, rtol=1e-12)
        np.testing.assert_allclose(stats[key]["mean"], values.mean(0, dtype=np.float64))
        np.testing.assert_allclose(stats[key]["std"], values.std(0, dtype=np.float64))
        assert stats[key]["min"] == values.min(0).tolist() and stats[key]["count"] == [60]


@examples(20)
@given(st.integers(1, 50), st.integers(0, 2**16))
def test_statistics_do_not_depend_on_the_order_of_episodes(frames: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(frames, 3))
    first, shuffled = pooled_stats(values), pooled_stats(rng.permutation(values))
    for name, value in first.items():
        np.testing.assert_allclose(value, shuffled[name], atol=1e-12)
