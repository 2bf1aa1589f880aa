"""What an option buys is measured by training it: one tiny variant from end to end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.probes.hard_sets import HETERO_HARD, draw_hard
from benchmarks.probes.zero_shot import Table
from benchmarks.tokenizer_options import VARIANTS, OptionsCommand, _short, draw_options, main, measure_variant
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.tokenizer.head_training import HeadTrainingConfig

FEW_PAIRS = (
    "run.data.units=2",
    "run.data.units_per_shard=1",
    "run.data.pairs_per_unit=2",
    "run.pairs_per_unit=2",
)


def test_a_variant_is_trained_read_and_summed_up(tmp_path: Path) -> None:
    recipe = replace(HETERO_HARD, sequences=2, length=3, canonicalise=False)
    sets = {name: draw_hard(recipe, as_virtual(name), 128) for name in ("tactip", "uskin")}
    table = Table(sets, sets, HeadTrainingConfig(steps=2))
    command = OptionsCommand(steps=2, out=str(tmp_path))
    found = measure_variant(command, table, (*FEW_PAIRS, "run.model.material=2"))
    assert set(found["row"]) == {"T->T", "T->U", "U->T", "U->U"} and len(found["worst_r2"]) == 3
    assert np.isfinite(found["summary"]["mean"])
    again = measure_variant(command, table, (*FEW_PAIRS, "run.model.material=2"))
    assert again["tokenizer_hash"] == found["tokenizer_hash"]  # finished trainings are kept


def test_unknown_options_are_named(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["only=magic", f"results={tmp_path}"]) == 2
    assert "latent of three" in capsys.readouterr().err


def test_no_two_options_share_a_folder() -> None:
    names = ["_".join(map(_short, overrides)) for overrides in VARIANTS.values()]
    assert len(set(names)) == len(names) and _short("run.loss.kl_weight=0.3") == "kl_weight-0.3"


def test_options_are_drawn_from_their_file(tmp_path: Path) -> None:
    summary = {"shear_worst": 0.5, "shear_mean": 0.6, "fz_mean": -9.0, "mae_fz_N": 2.0}
    options = {"the nano recipe": {"summary": summary}, "worse": {"summary": summary | {"shear_worst": -3.0}}}
    path = draw_options({"steps": 5, "set": "s", "options": options}, tmp_path / "options.png")
    assert path.stat().st_size > 1000
