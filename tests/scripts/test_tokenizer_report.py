"""The report's questions that don't need minutes: errors that say what to do, and a user's own
recordings."""

import json
from dataclasses import replace

from benchmarks import tokenizer_report
from benchmarks.probes.hard_sets import HETERO_HARD, draw_hard
from benchmarks.probes.labelled_set import set_facts
from benchmarks.probes.report_sets import REPORT_SETS
from benchmarks.probes.zero_shot import Table
from benchmarks.tokenizer_report import TokenizerReportCommand, main, measure
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig
from uniforce_vtla.tokenizer.force_head import HeadTrainingConfig


def test_a_table_needs_a_frozen_set(tmp_path, refuses):
    folders = [f"{name}={tmp_path}" for name in ("results", "facts", "cache")]
    refuses(main, ["set=hetero_hard_v2", *folders], "freeze=true")


def test_one_row_measured_anew_leaves_the_rest_of_the_table(tmp_path, monkeypatch):
    recipe = replace(HETERO_HARD, sequences=2, length=3, canonicalize=False)
    sets = {name: draw_hard(recipe, as_virtual(name), 128) for name in ("tactip", "uskin")}
    table = Table(sets, sets, HeadTrainingConfig(steps=2))
    monkeypatch.setattr(tokenizer_report, "draw_sets", lambda *_: table)
    report_set = REPORT_SETS["hetero_hard_v2"]
    (tmp_path / report_set.facts_file).write_text(json.dumps(set_facts(recipe, sets)))
    tokenizer = Tokenizer.random(TokenizerConfig(width=16, depth=1, heads=2))
    command = TokenizerReportCommand(
        set=report_set.name, results=str(tmp_path), facts=str(tmp_path), seeds=1
    )
    before = measure(replace(command, only="mean,UniForce"), report_set, tokenizer)
    before |= {"speed": {"ours": 1}, "measured_by": {"mean": {"command": "yesterday's"}}}
    (tmp_path / report_set.table).write_text(json.dumps(before))
    after = measure(replace(command, only="UniForce"), report_set, tokenizer)
    assert list(after["rows"]) == list(before["rows"]) and after["speed"] == {"ours": 1}
    assert set(after["rows"]) == {"mean", "UniForce"}
    assert after["measured_by"]["mean"]["command"] == "yesterday's"
    assert after["measured_by"]["UniForce"]["command"] == after["command"]
