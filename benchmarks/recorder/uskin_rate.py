"""The taxels' full rate against the stand-in: scans per second, how old the newest is, and whether any was lost."""

import time

import numpy as np

from uniforce_robots.sensors.reader import ReaderLimits, SampleReader
from uniforce_robots.sensors.uskin_slcan import SlcanUSkin
from uniforce_robots.standins.process import StandIn

FIRST_MS = 30_000  # for the first scan, on a starved machine
ANY_AGE_MS = 1e4


def measure_rate(seconds: float, rate_hz: float = 500.0) -> dict[str, float]:
    """Read a stand-in of its own for some time; every scan it sent is waited for.

    Returns:
        seconds: it lasted.
        rate_hz: scans received per second at its end.
        sent, samples, lost, bad: scans sent, received, torn, and lines not understood.
        age_p50_ms, age_p99_ms: of the newest scan, asked for at random times.
    """
    with StandIn("slcan", f"rate_hz={rate_hz}") as stand_in:
        source = SlcanUSkin(stand_in.address)
        source.max_behind_s = 1e9
        reader = SampleReader(source, ReaderLimits(frozen_after=50))
        reader.start()
        try:
            reader.wait_newer(-1, FIRST_MS)
            p50_ms, p99_ms = np.percentile(_ages_ms(reader, seconds), (50, 99)).tolist()
            seen_hz = reader.rate_hz()
            stand_in.inject("stall")
            sent = _until_all_arrived(stand_in, reader)
        finally:
            reader.stop()
    counts = reader.counts
    numbers = {"samples": counts.samples, "lost": counts.lost, "bad": counts.bad, "sent": sent}
    rates = {"seconds": seconds, "rate_hz": seen_hz, "age_p50_ms": p50_ms, "age_p99_ms": p99_ms}
    return numbers | {name: round(value, 3) for name, value in rates.items()}


def _ages_ms(reader: SampleReader, seconds: float) -> list[float]:
    rng, end_s, ages = np.random.default_rng(0), time.monotonic() + seconds, []
    while time.monotonic() < end_s:
        time.sleep(rng.uniform(0.002, 0.012))  # at no fixed phase to the scans
        ages.append(reader.newest(ANY_AGE_MS).age_ms)
    return ages


def _until_all_arrived(stand_in: StandIn, reader: SampleReader) -> int:
    """Return the scans that were sent, once the last of them had time to arrive."""
    before = -1
    while reader.counts.samples != before:
        before = reader.counts.samples
        time.sleep(0.3)
    return stand_in.stats()["sent"]
