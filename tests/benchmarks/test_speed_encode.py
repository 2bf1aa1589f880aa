"""The tokenizer's benches run, count what they say they count, and would show a leak."""

import numpy as np
import pytest

from benchmarks.speed import encode as bench
from uniforce_vtla.tokenizer.streaming import StreamingEncoder, StreamStep


def test_cache_answers_as_the_full_path_does() -> None:
    found = bench.bench_cached(0.2)
    assert found["cached_max_abs_difference"] <= 1e-5
    assert found["cached_times_faster"] > 1


def test_a_leak_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "SETTLING_FRAMES", 2)
    kept = []
    step = StreamingEncoder.step

    def leaky(self: StreamingEncoder, image: np.ndarray) -> StreamStep:
        if len(kept) < 10:
            # 46 MB: too large for a hole that another test left in the heap
            kept.append(np.ones((2400, 2400)))
        return step(self, image)

    assert bench.bench_stream(0.3)["stream"]["grown_MB"] < 50
    monkeypatch.setattr(StreamingEncoder, "step", leaky)
    found = bench.bench_stream(1.5)["stream"]
    assert found["frames"] > 0 and found["grown_MB"] > 2 * 46
