"""Late answers are counted, and a rollout says how many there were."""

from __future__ import annotations

import pytest

from lerobot_policy_pi05_uniforce.controller import Deadlines, PolicyController, shipped_checkpoint
from uniforce_vtla.errors import ContractError


def test_a_call_is_due_when_the_queue_runs_dry() -> None:
    account = Deadlines(control_hz=10)
    assert account.facts() == {}
    account.record(0.09, queued=0)  # within the present step
    account.record(0.11, queued=0)  # one step without a new action
    account.record(0.29, queued=2)  # two queued actions and the present step cover it
    account.record(0.55, queued=2)  # three steps too late
    facts = account.facts()
    assert (facts["calls"], facts["missed_deadlines"], facts["empty_steps"]) == (4, 2, 4)
    assert facts["latency_max_ms"] == pytest.approx(550) and facts["latency_p50_ms"] == pytest.approx(200)


def test_a_rate_must_be_one() -> None:
    with pytest.raises(ContractError, match="control rate"):
        Deadlines(0)


class Slow:
    """An environment's clock so fast that nobody is in time, or so slow that everybody is."""

    def __init__(self, hz: float) -> None:
        self.metadata = {"render_fps": hz}


@pytest.mark.parametrize(("hz", "missed"), [(1e6, 1), (1e-3, 0)])
def test_the_controller_holds_itself_to_the_environments_rate(hz, missed, monkeypatch) -> None:
    controller = PolicyController(shipped_checkpoint(), {"left": "gelsight", "right": "tactip"})
    monkeypatch.setattr(controller, "_batch", lambda observation, task: {})
    monkeypatch.setattr(controller, "_issue", lambda batch: "a chunk")
    controller.reset(Slow(hz))
    assert controller.facts() == {}
    assert controller.chunk({}, "wipe") == "a chunk"
    assert controller.facts()["missed_deadlines"] == missed and controller.facts()["calls"] == 1
