"""Success over demos: which checkpoints are found, in what order, and what is written of them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import success_over_demos as module
from benchmarks.success_over_demos import SuccessOverDemosConfig, main, points
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from uniforce_cli import score as scoring
from uniforce_vtla.errors import ContractError, DatasetError
from uniforce_vtla.evaluation.arms import EpisodeRow


@pytest.fixture
def checkpoints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folders as ``python -m benchmarks.train_arm`` names them; their settings are read by a stand-in."""
    told = {"vt": "96", "vt_5demos": "10", "vt_12demos": "24", "v": "96", "vtg": "48"}
    for name in told:
        (tmp_path / "seed0" / name).mkdir(parents=True)
        (tmp_path / "seed0" / name / "config.json").write_text("{}")

    def settings(folder: Path) -> PI05UniforceConfig:
        return PI05UniforceConfig(size="tiny", trained_on={"episodes": told[folder.name]})

    monkeypatch.setattr(module, "stored_config", settings)
    return tmp_path / "seed0"


def test_an_arms_checkpoints_are_found_from_few_to_many_demos_and_no_other_arms(checkpoints: Path) -> None:
    found = points(SuccessOverDemosConfig(checkpoints=str(checkpoints), only="V+T, V"))
    assert [(p.arm.name, p.demos) for p in found] == [("V+T", 10), ("V+T", 24), ("V+T", 96), ("V", 96)]


def test_what_is_not_there_is_said(checkpoints: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DatasetError, match="name=vtu"):
        points(SuccessOverDemosConfig(checkpoints=str(checkpoints), only="V+T+U"))
    with pytest.raises(ContractError, match="expert"):
        points(SuccessOverDemosConfig(checkpoints=str(checkpoints), only="expert"))
    monkeypatch.setattr(module, "stored_config", lambda _: PI05UniforceConfig(size="tiny"))
    with pytest.raises(DatasetError, match="a number of episodes"):
        points(SuccessOverDemosConfig(checkpoints=str(checkpoints)))


def test_each_checkpoint_is_scored_on_the_same_scenes(
    checkpoints: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fake(job: scoring.Job) -> tuple[int, EpisodeRow]:
        clean = not job.config.policy.endswith("_5demos")
        return job.index, EpisodeRow(job.seed, "success", clean, False, not clean, 0, 0, 0, 0, 0, 0)

    monkeypatch.setattr(scoring, "score_job", fake)
    where = [f"checkpoints={checkpoints}", f"out={tmp_path / 'out'}", f"results={tmp_path}"]
    assert main([*where, "rollouts=3", "first_seed=7", "workers=1"]) == 0
    curve = json.loads((tmp_path / "success_over_demos.json").read_text())["curves"]["V+T"]
    assert [(p["demos"], p["clean"], p["seeds"]) for p in curve] == [
        (10, 0, [7, 9]),
        (24, 3, [7, 9]),
        (96, 3, [7, 9]),
    ]
    assert (tmp_path / "success_over_demos.png").stat().st_size > 1000
    assert "V+T 24 demos" in capsys.readouterr().out
    assert main([*where, "only=V+T+U"]) == 2
