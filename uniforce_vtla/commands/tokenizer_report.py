"""Zero-shot force table of the tokenizer: six transfers on the frozen set, rows that keep it honest."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from uniforce_vtla.commands.arguments import parse
from uniforce_vtla.errors import DatasetError, UniForceError, expected
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.head_training import HeadTrainingConfig, train_head
from uniforce_vtla.tokenizer.labelled_set import (
    FROZEN,
    HEAD_TRAINING,
    SENSORS,
    LabelledSet,
    SetConfig,
    draw_labelled,
    set_facts,
)
from uniforce_vtla.tokenizer.weights import ASSETS
from uniforce_vtla.tokenizer.zero_shot import (
    POOL,
    Cells,
    Table,
    check_frozen,
    descriptor_row,
    encode_set,
    learnt_row,
    mean_row,
    shipped_cell,
    summary,
    transfer_name,
    transfers,
)
from uniforce_vtla.tokenizer.zero_shot_figure import draw_table

SET_FILE, TABLE_FILE = "zero_shot_set.json", "zero_shot_force.json"
REPLAY_TOLERANCE = 0.01  # R²; the same images and weights on another CPU differ far less


@dataclass
class TokenizerReportCommand:
    """Measure zero-shot force, or freeze the set, train the shipped heads, or replay the committed table.

    Example: uniforce-tokenizer-report replay=2 results=docs/results
    """

    tokenizer: str = ""  # checkpoint folder; empty = shipped
    results: str = "docs/results"  # the set, the table and its figure
    seeds: int = 3  # heads per cell
    freeze: bool = False  # only draw the set and write its hash
    ship_heads: bool = False  # also train one head per sensor and put it into the package
    only: str = ""  # re-measure one row by name, keep the others from the committed table
    replay: int = 0  # only re-measure so many cells from the shipped heads and compare


def freeze(results: Path) -> Path:
    """Write the frozen set's recipe and hash."""
    digests = {s: draw_labelled(FROZEN, s, side=8).digest for s in SENSORS}
    return write_json(results / SET_FILE, set_facts(FROZEN, digests) | provenance())


def measure(command: TokenizerReportCommand, tokenizer: Tokenizer) -> dict[str, Any]:
    """Return the table's content; every learnt row is trained here, on the source sensor alone."""
    facts = json.loads((Path(command.results) / SET_FILE).read_text())
    table = Table(_draw(HEAD_TRAINING, tokenizer), _draw(FROZEN, tokenizer))
    check_frozen(facts, table.frozen)
    if command.ship_heads:
        ship_heads(table, tokenizer)
    untrained = Tokenizer.random(tokenizer.config)
    seeds = command.seeds
    makers: dict[str, Callable[[], Cells]] = {
        "UniForce": lambda: learnt_row(table, lambda s: encode_set(tokenizer, s), seeds, POOL),
        "hand descriptor": lambda: descriptor_row(table, seeds),
        "random encoder": lambda: learnt_row(table, lambda s: encode_set(untrained, s), seeds, POOL),
        "mean": lambda: mean_row(table),
    }
    kept = _committed_rows(command, facts, tokenizer) if command.only else {}
    rows = {name: kept[name] if name in kept else make() for name, make in tqdm(makers.items(), desc="rows")}
    return {
        "what": "simulated; head trained on the source sensor, seen indenters; scored on unseen indenters",
        "set": facts["set"],
        "set_hash": facts["set_hash"],
        "seeds": seeds,
        "tokenizer_hash": tokenizer.hash,
        "summary": {name: summary(row) for name, row in rows.items()},
        "rows": rows,
        "shipped_heads": shipped_row(tokenizer, table.frozen, len(transfers())),
    } | provenance()


def _committed_rows(
    command: TokenizerReportCommand, facts: dict[str, Any], tokenizer: Tokenizer
) -> dict[str, Cells]:
    """Return the committed table's rows other than ``only``, if set, seeds and tokenizer are the same."""
    table = json.loads((Path(command.results) / TABLE_FILE).read_text())
    came = (table["set_hash"], table["tokenizer_hash"], table["seeds"])
    wanted = (facts["set_hash"], tokenizer.hash, command.seeds)
    if came != wanted or command.only not in table["rows"]:
        raise DatasetError(expected("committed table", wanted, came, "Measure all rows: leave out only=."))
    return {name: row for name, row in table["rows"].items() if name != command.only}


def ship_heads(table: Table, tokenizer: Tokenizer) -> None:
    """Train one head per source sensor and write it into the package."""
    for source in tqdm(SENSORS, desc="shipped heads"):
        labelled = table.training[source]
        model = train_head(encode_set(tokenizer, labelled), labelled.force_N, HeadTrainingConfig(), seed=0)
        ForceHead(model, source, tokenizer.hash).save(ASSETS / f"force_head_{source}")


def shipped_row(tokenizer: Tokenizer, frozen: dict[str, LabelledSet], count: int) -> Cells:
    """Return the first ``count`` transfers as the shipped heads do them."""
    cells = {}
    for source, target in transfers()[:count]:
        head = ForceHead.from_pretrained(source)
        cells[transfer_name(source, target)] = shipped_cell(head, tokenizer, frozen[target])
    return cells


def replay(command: TokenizerReportCommand, tokenizer: Tokenizer) -> float:
    """Re-measure cells from the shipped weights; return the largest difference of R² to the committed table."""
    results = Path(command.results)
    frozen = _draw(FROZEN, tokenizer)
    _say_if_redrawn(results, frozen)
    committed = json.loads((results / TABLE_FILE).read_text())["shipped_heads"]
    again = shipped_row(tokenizer, frozen, command.replay)
    return max(
        abs(x - y) for name in again for x, y in zip(again[name]["r2"], committed[name]["r2"], strict=True)
    )


def _say_if_redrawn(results: Path, frozen: dict[str, LabelledSet]) -> None:
    """Another CPU may round a marker's edge otherwise: the numbers must still agree, so go on, but say so."""
    try:
        check_frozen(json.loads((results / SET_FILE).read_text()), frozen)
    except DatasetError as error:
        print(f"note: {error}")


def _draw(config: SetConfig, tokenizer: Tokenizer) -> dict[str, LabelledSet]:
    side = tokenizer.config.side
    return {s: draw_labelled(config, s, side) for s in tqdm(SENSORS, desc=f"drawing {config.name}")}


def _report(command: TokenizerReportCommand) -> str:
    results = Path(command.results)
    if command.freeze:
        return f"set frozen in {freeze(results)}"
    tokenizer = Tokenizer.from_pretrained(command.tokenizer or None)
    if command.replay:
        worst = replay(command, tokenizer)
        verdict = "agrees with" if worst <= REPLAY_TOLERANCE else "DIFFERS FROM"
        return f"replay of {command.replay} cells {verdict} {results / TABLE_FILE}: largest difference {worst:.4f}"
    content = measure(command, tokenizer)
    write_json(results / TABLE_FILE, content)
    draw_table(content, results / "zero_shot_force.png")
    lines = [f"{name:16s} " + _numbers(values) for name, values in content["summary"].items()]
    return "\n".join([*lines, f"table and figure in {results}"])


def _numbers(values: dict[str, float]) -> str:
    return "  ".join(f"{name} {value:.2f}" for name, value in values.items())


def main(argv: list[str] | None = None) -> int:
    """Entry of ``uniforce-tokenizer-report``."""
    logging.basicConfig(level=logging.INFO)
    command = parse(TokenizerReportCommand, argv)
    torch.set_num_threads(1)
    try:
        print(_report(command))
    except UniForceError as error:
        print(f"tokenizer_report: {error}")
        return 2
    return 0
