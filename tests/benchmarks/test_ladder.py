"""The plan of the swap ladder: names and blocks fit together, rows wait for what is missing, claims get verdicts."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.ladder import replay
from benchmarks.ladder.__main__ import (
    LadderCommand,
    add_best_blind,
    added,
    configured,
    filed,
    joined,
    judged,
    main,
    wanted,
)
from benchmarks.ladder.plan import BETTER, CLAIMS, PARTS, Entry, claims
from benchmarks.scene_blocks import BLOCKS
from uniforce_cli.score_settings import ScoreConfig
from uniforce_vtla.errors import ContractError
from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow


def test_the_plan_names_blocks_and_rows_that_exist() -> None:
    rows = [entry for part in PARTS.values() for entry in part]
    names = {entry.name for entry in rows}
    assert len(names) == len(rows), "two rows of one name"
    assert all(entry.rollouts <= len(BLOCKS[entry.block]) for entry in rows)
    assert {claim.first for claim in CLAIMS} | {claim.second for claim in CLAIMS} <= names
    assert {name for pair in BETTER for name in pair} <= names | {"best blind"}
    final = [entry for part, entries in PARTS.items() for entry in entries if part != "grip"]
    assert all(BLOCKS[entry.block].start >= 1_000_000 for entry in final), (
        "development scenes stand aside"
    )


def test_rows_wait_for_checkpoints_and_calibrations(tmp_path: Path) -> None:
    config = LadderCommand(checkpoints=str(tmp_path))
    calibrated = Entry("S2", "vt", ("uskin:2", "uskin:3"), "left", "touch0:left", calibrated=True)
    assert not configured(config, calibrated) and not configured(config, Entry("S0", "vt"))
    for folder in ("vt/seed0", "vt/seed1", "maps/shipped/uskin-2"):
        (tmp_path / folder).mkdir(parents=True)
    config.calibrations = str(tmp_path / "maps")
    assert not configured(config, calibrated)
    (tmp_path / "maps/shipped/uskin-3").mkdir()
    first, second = configured(config, calibrated)
    assert (
        first.left_calibration == str(tmp_path / "maps" / "shipped" / "uskin-2")
        and second.left_sensor == "uskin:3"
    )
    assert [Path(policy).name for policy in first.policies] == ["seed0", "seed1"]
    assert [*first.seeds, *second.seeds] == [
        *range(BLOCKS["swap ladder"].start, BLOCKS["swap ladder"].start + 204)
    ]


def test_rows_are_picked_by_name_in_the_plans_order() -> None:
    assert [entry.name for entry in wanted(LadderCommand(rows="S1, S0"))] == ["S0", "S1"]
    assert wanted(LadderCommand()) == list(PARTS["ladder"])
    with pytest.raises(ContractError, match="S2 tactip"):
        wanted(LadderCommand(rows="S0,S2 tactip"))


def test_a_rows_parts_are_joined_and_counted_by_training_seed(tmp_path: Path) -> None:
    parts = [
        ScoreConfig(policy="a,b", arm="S2", first_seed=first, rollouts=4, out=str(tmp_path / "out"))
        for first in (10, 14)
    ]
    clean = [True, False, True, False]
    one = ArmReport(
        "S2",
        [
            EpisodeRow(k, "success", ok, False, False, 0, 0, 0, 0, 0, 0)
            for k, ok in enumerate(clean)
        ],
    )
    scored = [one for _ in parts]
    shifted = [
        ArmReport("S2", [replace(row, seed=row.seed + part.first_seed) for row in report.rows])
        for part, report in zip(parts, scored, strict=True)
    ]
    report, seeds = joined(parts, shifted)["S2"]
    assert report.n == 8 and [row.seed for row in report.rows] == [*range(10, 18)]
    assert seeds == ["4/4", "0/4"]


def test_a_claim_holds_within_its_margin_and_bound() -> None:
    good, poor = (dict(enumerate([True] * n + [False] * (200 - n))) for n in (190, 150))
    (held,) = claims({"S0": good, "S1": good})
    assert held["holds"] and held["difference"] == 0
    (broken,) = claims({"S0": good, "S1": poor})
    assert not broken["holds"]


@pytest.mark.slow
def test_the_expert_alone_is_scored_and_the_rest_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [
        "part=arms",
        f"checkpoints={tmp_path}",
        "level=easy",
        "rollouts=1",
        "first_seed=20000",
        "workers=1",
    ]
    given += [f"work={tmp_path / 'work'}", f"out={tmp_path / 'wiping.json'}"]
    assert main(given) == 0
    assert "not scored: V+T" in capsys.readouterr().out
    first = json.loads((tmp_path / "wiping.json").read_text())
    assert first["side_arms"]["expert"]["clean"] == 1 and (tmp_path / "wiping_arms.png").is_file()
    assert main([*given, f"onto={tmp_path / 'wiping.json'}"]) == 0
    again = json.loads((tmp_path / "wiping.json").read_text())
    assert again["side_arms"] == first["side_arms"] and len(again["scored_by"]) == 2
    assert main(["part=ladder", f"checkpoints={tmp_path}", f"work={tmp_path / 'work'}"]) == 2


def part_of(part: str, **counts: int) -> dict:
    rows = {
        name: {
            "n": n,
            "clean": n,
            "clean_by_training_seed": ["1/1"] * 3,
            "seeds": [0, n - 1],
            "by_seed": "C" * n,
        }
        for name, n in counts.items()
    }
    return filed(part, "touch", rows)


def test_rows_stand_in_their_sections_and_small_arms_stand_aside() -> None:
    arms = part_of("arms", **{"V": 204, "V+T masked": 102})
    found = added(part_of("ladder", **{"S2 uskin": 204}), arms)
    assert list(found["ladder"]) == ["S2_uskin"] and list(found["arms"]) == ["V"]
    assert list(found["side_arms"]) == ["V+T masked"] and found["training_seeds"] == 3
    more = added(part_of("controls", **{"whole latents S0": 102}), found)
    assert list(more["ladder_controls"]) == ["whole latents S0"] and more["arms"] == found["arms"]
    assert len(more["scored_by"]) == 3
    with pytest.raises(ContractError, match="level of the earlier report"):
        added(found, found | {"level_hash": "b"})


def test_claims_and_tests_are_of_rows_that_were_scored_in_different_parts() -> None:
    ladder, arms = (
        part_of("ladder", **{"S0": 204, "S2 uskin": 204}),
        part_of("arms", **{"V+T": 204, "V+T masked": 102}),
    )
    ladder["ladder"]["S2_uskin"]["by_seed"] = "r" * 204
    found = judged(added(ladder, arms))
    assert [(claim["arms"], claim["holds"]) for claim in found["within"]] == [
        (["S2 uskin", "S0"], False)
    ]
    assert [(test["arms"], test["n"]) for test in found["tests"]] == [(["V+T", "V+T masked"], 102)]
    again = judged(added(part_of("ladder", **{"S2 uskin": 68}), found))
    assert again["within"][0]["n"] == 68 and again["within"][0]["holds"]


def test_the_best_script_without_touch_stands_beside_the_arms() -> None:
    found = part_of("arms", **{"V+T": 204})
    found["arms"]["V+T"] |= {"seeds": [10, 13], "by_seed": "CCCr"}
    blind = {
        "open loop": {"clean": 0, "by_seed": "rrrr"},
        "plane known": {"clean": 1, "by_seed": "Crrr"},
    }
    gates = {"level_hash": found["level_hash"], "seeds": [10, 13], "must_fail": blind}
    add_best_blind(found, gates)
    assert found["arms"]["best blind"]["script"] == "plane known"
    (test,) = judged(found)["tests"]
    assert test["points"] == 50 and test["arms"] == ["V+T", "best blind"]
    with pytest.raises(ContractError, match="arms' scenes"):
        add_best_blind(found, gates | {"seeds": [20, 23]})


def test_a_replay_takes_the_scenes_of_the_shipped_policys_turn_and_compares(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    row = {
        "n": 24,
        "seeds": [500, 523],
        "by_seed": 8 * "Crs",
        "clean_by_training_seed": ["8/8", "0/8", "0/8"],
    }
    results = tmp_path / "wiping.json"
    results.write_text(
        json.dumps({"arms": {}, "side_arms": {}, "ladder": {"S1": row}, "ladder_controls": {}})
    )
    asked, ends = [], ["success"]

    def scored(configs: list[ScoreConfig], workers: int) -> list[ArmReport]:
        asked.extend((config.policy, config.right_sensor, config.first_seed) for config in configs)
        ended = EpisodeRow(500, ends[0], ends[0] == "success", False, False, 0, 0, 0, 0, 0, 0)
        return [ArmReport("S1", [ended]) for _ in configs]

    monkeypatch.setattr(replay, "score_arms", scored)
    given = [f"results={results}", f"work={tmp_path}"]
    assert replay.main(["row=S1", "scenes=2", *given]) == 0
    assert asked == [("shipped", "tactip:any", 500), ("shipped", "tactip:any", 503)]
    ends[0] = "residual"
    assert replay.main(["row=S1", "scenes=2", *given]) == 0, "two scenes lost may be chance"
    assert replay.main(["row=S1", "scenes=8", *given]) == 1
    assert "DIFFERS" in capsys.readouterr().out
    assert replay.main(["row=S2 uskin calibrated", *given]) == 2
