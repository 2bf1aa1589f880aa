"""A 30 Hz loop that does nothing, on the recorder's own ticker: what beat this machine can keep.

``python -m benchmarks.recorder.idle_loop RATE_HZ`` ticks until its standard input ends, then prints
``{"time_s": […], "late_ms": […]}``.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from types import TracebackType

import numpy as np

from benchmarks.recorder.session import environment
from uniforce_robots.recorder.ticker import Ticker

END_s = 60.0


class IdleLoop:
    """Runs beside a session, in a process of its own.

    Args:
        rate_hz: of the beat.
    """

    def __init__(self, rate_hz: float) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.recorder.idle_loop", str(rate_hz)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment(),
        )

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def __enter__(self) -> IdleLoop:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.communicate()

    def stop(self) -> tuple[np.ndarray, np.ndarray]:
        """End it; return (when each beat came, ``time.monotonic`` s, how late it was, ms)."""
        said, _ = self._process.communicate(timeout=END_s)
        beats = json.loads(said)
        return np.array(beats["time_s"]), np.array(beats["late_ms"])


def _wait_for_the_end(over: threading.Event) -> None:
    sys.stdin.read()
    over.set()


def main() -> int:
    """Tick until standard input ends."""
    over = threading.Event()
    threading.Thread(target=_wait_for_the_end, args=(over,), daemon=True).start()
    ticker, time_s, late_ms = Ticker(float(sys.argv[1])), [], []
    while not over.is_set():
        late_ms.append(round(1e3 * ticker.wait(), 4))
        time_s.append(round(time.monotonic(), 4))
    sys.stdout.write(json.dumps({"time_s": time_s, "late_ms": late_ms}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
