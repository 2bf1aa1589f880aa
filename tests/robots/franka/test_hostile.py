"""Every named fault of the stand-in against the real client, once; ``make faults``: ten times."""

from dataclasses import replace

import psutil
import pytest

from benchmarks.trust.hostile import attack, summarise
from benchmarks.trust.hostile_arm import FAULTS
from benchmarks.trust.hostile_trials import RIGHT_NAMES, Trial, begun_trial


@pytest.mark.thorough
def test_a_fault_holds_the_arm_and_is_named(tmp_path):
    faults = sorted(FAULTS)
    assert set(RIGHT_NAMES) == set(FAULTS)
    rows = attack(faults, 1, tmp_path)
    assert len(rows) == len(faults)
    assert [row for row in rows if not row.is_right] == []


def test_a_wrong_name_a_late_hold_and_a_taken_action_are_seen():
    right = Trial("reflex", "reflex", "", hold_s=0.1, learnt_s=0.1)
    assert right.is_right
    changes = [
        {"named": ""},
        {"hold_s": 0.6},
        {"learnt_s": 0.6},
        {"sent_after": 1},
        {"fingers_m": 0.002},
    ]
    wrong = [replace(right, **change) for change in changes]
    assert not any(trial.is_right for trial in wrong)
    line = summarise([right, *wrong])["reflex"]
    assert (line["trials"], line["named_right"], line["held"], line["sent_after"]) == (6, 5, 4, 1)


def test_a_client_that_hangs_ends_with_the_robot(address, tmp_path):
    row = begun_trial("garbage_state", address, tmp_path)
    assert row.named in RIGHT_NAMES["garbage_state"]
    left = [
        word
        for child in psutil.Process().children()
        for word in child.cmdline()
        if "franka/children" in word
    ]
    assert not left
