"""A real-time test is judged on time the machine gave us, and only then excused."""

import os
import signal
import time
from contextlib import closing

import pytest
from fair_clock import TRIES, Witnesses

pytest_plugins = ["pytester"]

FLAKY = """
import pytest
runs = []

@pytest.fixture
def fresh(tmp_path):
    assert not list(tmp_path.iterdir())
    (tmp_path / "used").touch()

{mark}
def test_it(fresh):
    runs.append(0)
    assert len(runs) >= {passes_at}
"""
CONFTEST = """
from fair_clock import FairClock

class Scripted:
    def __init__(self, lost): self.lost, self.waits = iter(lost), 0
    def lost_s(self): return next(self.lost)
    def wait_for_calm(self): self.waits += 1
    def close(self): pass

def pytest_configure(config):
    config.addinivalue_line("markers", "realtime: x")
    config.pluginmanager.register(FairClock(Scripted({lost})))
"""


def run(pytester, lost, passes_at, mark="@pytest.mark.realtime"):
    pytester.makeconftest(CONFTEST.format(lost=lost))
    flaky = pytester.makepyfile(FLAKY.format(mark=mark, passes_at=passes_at))
    return pytester.inline_run(flaky, "-p", "no:cacheprovider")


def test_a_witness_sees_a_core_taken_away():
    with closing(Witnesses()) as seen:
        time.sleep(0.5)
        before_s = seen.lost_s()
        victim = seen.processes[-1].pid
        os.kill(victim, signal.SIGSTOP)
        time.sleep(0.4)
        os.kill(victim, signal.SIGCONT)
        time.sleep(0.1)
        assert seen.lost_s() - before_s >= 0.3
    assert all(process.returncode is not None for process in seen.processes)


@pytest.mark.parametrize(
    "lost, passes_at, outcome",
    [
        ([0.0, 9.0], 1, "passed"),  # a pass needs no calm
        ([0.0, 0.01], 2, "failed"),  # in calm: at once
        ([0.0, 0.5, 0.5, 0.5], 2, "passed"),  # while starved: runs again, with new fixtures
        ([0.0, 0.5, 0.5, 0.5], 9, "failed"),  # the second try was calm
        # a defect on a machine that is always starved
        ([0.3 * k for k in range(2 * TRIES)], 99, "failed"),
        ([0.3 * k for k in range(2 * TRIES)], TRIES, "passed"),
    ],
)
def test_a_failure_counts_unless_the_machine_was_starved(pytester, lost, passes_at, outcome):
    run(pytester, lost, passes_at).assertoutcome(**{outcome: 1})


def test_other_tests_need_no_witness(pytester):
    run(pytester, [], passes_at=2, mark="").assertoutcome(failed=1)
