"""Judge a test that runs against a clock only on time the machine gave us.

A shared machine may take both cores away for tenths of a second: a camera then looks stale and a
rate too high, though no line of ours is wrong. Two witnesses, processes that only sleep, one on
each core, tell how long each core was away in one piece; the kernel's count of stolen time (Linux)
tells of smaller pieces too. A real-time test that fails while they were starved runs again, a few
times: a test that fails each time has failed, so that no defect hides behind a busy machine. On a
machine that is calm nothing changes: a failure is a failure the first time.
"""

import mmap
import os
import struct
import subprocess
import sys
import tempfile
import time

import psutil
from _pytest.runner import runtestprotocol

NAP_S = 0.005
# beyond what a scheduler makes a sleeper wait while our own two or three threads compute
LATE_S = 0.030
# of the test's time, both; the tests' deadlines start at 0.1 s
STARVED_S, STARVED_SHARE = 0.060, 0.02
TRIES = 4
CALM_S = 1.0  # wait for so long without theft before another try …
PATIENCE_S = 15.0  # … but not longer than this

# Runs with the standard library alone, so that it costs 10 MB: sleeps, and adds up by how much it
# woke too late.
WITNESS = """
import mmap, os, struct, sys, time
path = sys.argv[1]
place, core = map(int, sys.argv[2:4])
nap_s, late_s = map(float, sys.argv[4:])
if core >= 0: os.sched_setaffinity(0, {core})
parent = os.getppid()
with open(path, "r+b") as file:
    lost = mmap.mmap(file.fileno(), 0)
lost_s, then_s = 0.0, time.monotonic()
while os.getppid() == parent:
    struct.pack_into("d", lost, 8 * place, lost_s)
    time.sleep(nap_s)
    now_s = time.monotonic()
    late = now_s - then_s - nap_s
    lost_s += late if late > late_s else 0.0
    then_s = now_s
"""


def stolen_s():
    """Return for how long a hypervisor ran others on our cores, all added up, as the kernel counts
    (Linux)."""
    return float(getattr(psutil.cpu_times(), "steal", 0.0))


class Witnesses:
    """One sleeping process for each core we may use."""

    def __init__(self):
        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [-1]
        with tempfile.NamedTemporaryFile(delete=False) as file:
            file.write(bytes(8 * len(cores)))
        with open(file.name, "r+b") as shared:
            self._lost = mmap.mmap(shared.fileno(), 0)
        limits = (str(NAP_S), str(LATE_S))
        self.processes = [
            subprocess.Popen(
                [
                    sys.executable,
                    "-I",
                    "-S",
                    "-c",
                    WITNESS,
                    file.name,
                    str(place),
                    str(core),
                    *limits,
                ]
            )
            for place, core in enumerate(cores)
        ]
        self._path = file.name

    def lost_s(self):
        """Return for how long cores were away, all added up; what both tell of counts twice."""
        return sum(struct.unpack(f"{len(self.processes)}d", self._lost)) + stolen_s()

    def wait_for_calm(self):
        end_s = time.monotonic() + PATIENCE_S
        before_s = -1.0
        while before_s != (before_s := self.lost_s()) and time.monotonic() < end_s:
            time.sleep(CALM_S)

    def close(self):
        for process in self.processes:
            process.kill()
            process.wait()
        os.unlink(self._path)


class FairClock:
    def __init__(self, witnesses=None):
        self.witnesses = witnesses
        self.again = []

    def pytest_runtest_protocol(self, item, nextitem):
        if not item.get_closest_marker("realtime"):
            return None
        self.witnesses = self.witnesses or Witnesses()
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in self._reports(item, nextitem):
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _reports(self, item, nextitem):
        for attempt in range(TRIES):
            if attempt:
                self.witnesses.wait_for_calm()
                item._initrequest()  # new fixtures, as for a test that never ran
            before_s, began_s = self.witnesses.lost_s(), time.monotonic()
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
            lost_s = self.witnesses.lost_s() - before_s
            fair = lost_s < max(STARVED_S, STARVED_SHARE * (time.monotonic() - began_s))
            if fair or not any(report.failed for report in reports):
                return reports
            self.again.append(f"{item.nodeid}: failed while cores were away for {lost_s:.2f} s")
        return reports

    def pytest_terminal_summary(self, terminalreporter):
        for line in self.again:
            terminalreporter.write_line(f"on a starved machine: {line}", yellow=True)

    def pytest_unconfigure(self):
        if self.witnesses:
            self.witnesses.close()
