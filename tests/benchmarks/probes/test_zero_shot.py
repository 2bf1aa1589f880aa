import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.probes.labelled_set import FROZEN, HEAD_TRAINING, SENSORS, draw_labelled, set_facts, within
from benchmarks.probes.report_sets import get_report_set
from benchmarks.probes.zero_shot import check_frozen, score, summary, transfer_name, transfers
from benchmarks.probes.zero_shot_figure import draw_table
from uniforce_vtla.contact.indenters import SEEN, UNSEEN
from uniforce_vtla.errors import DatasetError

RESULTS = Path(__file__).parents[3] / "docs" / "results"
SHORT = replace(FROZEN, sequences=2, length=3)


def test_frozen_indenters_are_unseen_and_training_ones_seen() -> None:
    assert set(FROZEN.indenters) == set(UNSEEN) and set(HEAD_TRAINING.indenters) == set(SEEN)
    assert not set(UNSEEN) & set(SEEN) and FROZEN.seed != HEAD_TRAINING.seed


def test_sensors_feel_the_same_contacts_and_draws_repeat() -> None:
    sets = {sensor: draw_labelled(SHORT, sensor, 16) for sensor in SENSORS}
    for labelled in sets.values():
        np.testing.assert_array_equal(labelled.force_N, sets["gelsight"].force_N)
        assert labelled.frames.shape == (2, 3, 16, 16) and labelled.descriptor.shape == (2, 3, 6)
    assert len({labelled.digest for labelled in sets.values()}) == 3
    assert draw_labelled(SHORT, "uskin", 16).digest == sets["uskin"].digest
    assert draw_labelled(replace(SHORT, seed=1), "uskin", 16).digest != sets["uskin"].digest


def test_a_set_that_changed_is_refused() -> None:
    drawn = {sensor: draw_labelled(replace(SHORT, sequences=1), sensor, 16) for sensor in SENSORS}
    facts = set_facts(FROZEN, {sensor: labelled.digest for sensor, labelled in drawn.items()})
    check_frozen(facts, drawn)
    with pytest.raises(DatasetError, match="freeze"):
        check_frozen(facts | {"set_hash": "0"}, drawn)


def test_score_of_truth_mean_and_offset() -> None:
    truth = np.random.default_rng(0).uniform(-2, 8, (5, 4, 3))
    assert score(truth, truth)["r2"] == [1, 1, 1]
    mean = np.broadcast_to(truth.reshape(-1, 3).mean(axis=0), truth.shape)
    assert score(truth, mean)["r2"] == pytest.approx([0, 0, 0])
    assert score(truth, truth + 0.5)["mae_N"] == pytest.approx([0.5] * 3)


def test_paper_range() -> None:
    force = np.array([[0, 0, 12.0], [3.1, 0, 1], [0, -3, 5], [0, 0, 12.1]])
    assert within(force).tolist() == [True, False, True, False]


@pytest.mark.parametrize("name", ["zero_shot_v1", "hetero_hard_v1"])
def test_committed_table_belongs_to_the_frozen_set_and_meets_its_form(name: str) -> None:
    report_set = get_report_set(name)
    if not (RESULTS / report_set.table).exists():
        pytest.skip(f"no table of {name} committed")
    table = json.loads((RESULTS / report_set.table).read_text())
    frozen = json.loads((RESULTS / report_set.facts_file).read_text())
    assert table["set_hash"] == frozen["set_hash"]
    for row in table["rows"].values():
        for source, target in transfers():
            assert len(row[transfer_name(source, target)]["r2"]) == 3
    assert summary(table["rows"]["UniForce"])["mean"] == pytest.approx(table["summary"]["UniForce"]["mean"])


def test_any_rows_make_a_picture(tmp_path: Path) -> None:
    cell = {"r2": [0.9, -157.0, 0.1], "mae_N_paper_range": [0.1, 0.2, 3.0]}
    rows = {"ResNet": {"G->G": cell, "G->T": cell, "T->G": cell}, "UniForce": {"G->T": cell, "T->G": cell}}
    path = draw_table({"rows": rows, "set": "some_set"}, tmp_path / "deep" / "table.png")
    assert path.stat().st_size > 10_000
