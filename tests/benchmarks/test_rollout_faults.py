"""LeRobot's own rollout, over the stand-ins, holds what fails; ``make faults`` tries every kind ten
times."""

import pytest

from benchmarks.trust.attempts import tally
from benchmarks.trust.rollout_faults import attempt
from benchmarks.trust.rollout_trials import KINDS, Trial


@pytest.mark.realtime
@pytest.mark.parametrize("kind", ["finger_unplugged", "policy_nan"])
def test_a_rollout_is_held_and_told_why(kind, tmp_path):
    (row,) = attempt(kind, 1, tmp_path)
    assert row.is_right, row
    assert attempt(kind, 1, tmp_path) == [row], "what is there isn't tried again"


def test_a_wrong_name_and_a_late_hold_are_seen():
    assert len(KINDS) >= 10
    right = Trial("arm_reflex", "reflex", "", 0.1, 0.2)
    late = Trial("arm_reflex", "reflex", "", 0.6, 0.7)
    unnamed = Trial("arm_reflex", "", "", 0.1, 0.2)
    assert right.is_right and not late.is_right and not unnamed.is_right
    line = tally([right, late, unnamed])["arm_reflex"]
    assert line.items() >= {"trials": 3, "named_right": 2, "held": 2, "worst_hold_s": 0.6}.items()
