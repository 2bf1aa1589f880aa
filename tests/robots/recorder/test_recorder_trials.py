"""Some of the trials: the real client against the stand-in arm, whole sessions, kills and faults.

Outcomes are asserted, timings aren't: those are what ``python -m benchmarks.recorder`` is for, on a
machine with time.
"""

import importlib.util

import pytest

from benchmarks.ledger import Ledger
from benchmarks.recorder import kill9
from benchmarks.recorder.device_faults import BREAKAGES, attended
from benchmarks.recorder.end_to_end import rate_and_jitter, record
from benchmarks.recorder.ending_faults import server_death
from benchmarks.recorder.faults import bench_of
from benchmarks.recorder.loading import load_in_stock_lerobot
from benchmarks.recorder.plan import Plan
from benchmarks.recorder.rig import Rig

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.timeout(900),
    pytest.mark.skipif(
        importlib.util.find_spec("franky") is None,
        reason="franky is not installed: pip install '.[franka]' to run the real client",
    ),
]
# the first has to be cleared
INJECTED = ("arm_reflex", "camera_stops", "uskin_garbage", "uskin_unplugged")


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    work = tmp_path_factory.mktemp("trials")
    # any machine keeps up with it
    gentle = Plan(work=str(work), episodes=2, episode_s=2.0, fps=5, patience=20.0, uskin_hz=50.0)
    with Rig(gentle, work / "rig") as rig:
        yield rig


def test_two_episodes_end_to_end(rig):
    root = rig.plan.folder / "two"
    found = record(rig, root)
    assert found["exit_code"] == 0
    seen = rate_and_jitter(root, [found])
    assert seen["labels"] == {"success": 2} and seen["frames"] == 20
    assert not seen["episodes_with_dropped_video"] and seen["idle_ticks"] > 0
    assert load_in_stock_lerobot(root)["loads_in_stock_lerobot"]


def test_kills_cost_no_saved_episode(rig):
    # all of it mid-tick, the loop mid-save, the storing process in between
    for number in (0, 4, 8):
        seen = kill9.kill_once(rig, rig.plan.folder / "killed", number)
        assert seen["said_stored"] and not seen["saved_lost"] and not seen["processes_left"], seen
    assert kill9.finish(rig, rig.plan.folder / "killed")["exit_code"] == 0


def test_faults_hold_the_arm_and_are_labelled(rig):
    """One session: a person goes on after each fault."""
    ledger = Ledger(rig.plan.folder / "found")
    rig.new_arm()
    attended(
        {name: BREAKAGES[name] for name in INJECTED},
        rig,
        ledger,
        rig.plan.folder / "broken",
        times=1,
    )
    for name in INJECTED:
        assert ledger.read(name)[0]["right_outcome"], (name, ledger.read(name))


def test_an_arm_that_is_gone_ends_the_session(rig):
    seen = server_death(bench_of("server_death", 0, rig))
    assert seen["right_outcome"], seen
