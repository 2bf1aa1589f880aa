"""The whole recorder in simulation: keeps what is good, goes on, gives up; and its flags mean something."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.pairs.evaluation import precision_recall, score_session
from benchmarks.pairs.training import ForceTraining, save_finger_force, train_finger_force, training_contacts
from uniforce_datasets.readers.uniforce_pairs import read_uniforce_pairs
from uniforce_robots.pairs.finger_force import FingerForce
from uniforce_robots.pairs.guided_grasp import GraspSettings
from uniforce_robots.pairs.recorder import KEPT, PairRecorder, RecordingPlan, SessionReport, Status
from uniforce_robots.pairs.rehearsal import LIMIT, Rehearsal, SimulatedRig
from uniforce_robots.pairs.rig import RigFrame
from uniforce_robots.pairs.storage import PairStore
from uniforce_vtla.errors import CheckpointError, DatasetError, SensorError

NAMES = ("sphere", "line")
PLAN = RecordingPlan(pairs=12, chunk=6, crowded=1.0)
QUICK = GraspSettings(frames=30)


def rehearse(
    root: Path, plan: RecordingPlan = PLAN, rig: SimulatedRig | None = None
) -> tuple[SessionReport, list[Status]]:
    seen: list[Status] = []
    rig = rig or SimulatedRig(Rehearsal("uskin", "tactip", seed=5, grasps=QUICK))
    with PairStore(root, "uskin", "tactip", NAMES, 15) as store:
        report = PairRecorder(rig, store, plan, seen.append).run()
        assert store.counts.tolist() == [plan.pairs] * len(NAMES)
    return report, seen


def test_it_records_exactly_what_was_asked_for(tmp_path: Path) -> None:
    report, seen = rehearse(tmp_path)
    assert report.outcomes[KEPT] == len(report.kept) == 24
    assert {pair.indenter for pair in read_uniforce_pairs(tmp_path / "uniforce_pairs")} == set(NAMES)
    assert seen[-1].have == 12 and seen[-1].indenter == 2 and seen[0].name == "sphere"
    again, _ = rehearse(tmp_path)
    assert not again.kept  # nothing is missing, so nothing is recorded


class Unplugged(SimulatedRig):
    """Loses a finger after so many frames."""

    def __init__(self, after: int) -> None:
        super().__init__(Rehearsal("uskin", "tactip", seed=5, grasps=QUICK))
        self._left = after

    def frames(self, indenter: str) -> Iterator[RigFrame]:
        for frame in super().frames(indenter):
            self._left -= 1
            if self._left < 0:
                raise SensorError("unplugged")
            yield frame


def test_a_lost_finger_costs_at_most_a_chunk(tmp_path: Path) -> None:
    with pytest.raises(SensorError):
        rehearse(tmp_path, replace(PLAN, pairs=30), Unplugged(after=32))
    with PairStore(tmp_path, "uskin", "tactip", NAMES, 15) as store:
        assert 0 < store.counts[0] < 30 and store.counts[0] % PLAN.chunk == 0 and store.next_session == 1


def test_a_crowded_cell_takes_no_more(tmp_path: Path) -> None:
    plan = replace(PLAN, chunk=12, crowded=0.25)
    report, seen = rehearse(tmp_path, plan)
    assert report.outcomes["crowded"] > 0
    assert seen[-1].coverage.force.max() <= 3


def test_hopeless_grasps_are_given_up_with_the_reason(tmp_path: Path) -> None:
    askew = replace(QUICK, fault_share=1.0, faults=("free",))
    rig = SimulatedRig(Rehearsal("uskin", "tactip", seed=5, grasps=askew))
    with pytest.raises(DatasetError, match="out of balance"):
        rehearse(tmp_path, replace(PLAN, give_up=10, longest_grasp=30), rig)


@pytest.mark.slow
def test_flags_are_right_where_the_fault_is_plain() -> None:
    """Not the bar, which `benchmarks.pair_quality` measures on thousands of pairs: that flags mean something at all."""
    settings = GraspSettings(faults=("free", "one_finger"), frames=30)
    scored = score_session(Rehearsal("uskin", "tactip", seed=11, grasps=settings), NAMES, 6)
    found = precision_recall(scored.flagged, scored.error > LIMIT)
    assert found["bad"] > 30 and found["precision"] > 0.8 and found["recall"] > 0.8
    turned = precision_recall(scored.flagged[::-1], scored.error > LIMIT)
    assert turned["precision"] < found["precision"]  # the test can fail


def test_a_reader_is_trained_saved_and_loaded(tmp_path: Path) -> None:
    training = ForceTraining(units=2, contacts=20, steps=60)
    fields, forces = training_contacts("uskin", training)
    model = train_finger_force(fields, forces, training)
    before = np.abs(FingerForce().read(fields) - forces).mean()
    assert np.abs(model.read(fields) - forces).mean() < 0.6 * before
    save_finger_force(model, "uskin", training, tmp_path / "uskin")
    assert np.array_equal(FingerForce.from_pretrained("uskin", tmp_path / "uskin").read(fields), model.read(fields))
    with pytest.raises(CheckpointError, match="uskin"):
        FingerForce.from_pretrained("tactip", tmp_path / "uskin")
    with pytest.raises(CheckpointError, match="train=true"):
        FingerForce.from_pretrained("thumb")


def test_precision_and_recall_are_counted_right() -> None:
    flagged, bad = np.array([1, 1, 1, 0, 0], bool), np.array([1, 1, 0, 1, 0], bool)
    found = precision_recall(flagged, bad)
    assert (found["precision"], found["recall"]) == (pytest.approx(2 / 3), pytest.approx(2 / 3))
    assert np.isnan(precision_recall(flagged, np.zeros(5, bool))["recall"])
