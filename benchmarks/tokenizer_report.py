"""Score a tokenizer's zero-shot force on a frozen set; freeze a set; train the shipped heads."""

import json
import logging
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tqdm import tqdm

from benchmarks.probes.labelled_set import set_facts
from benchmarks.probes.recorded_set import user_data
from benchmarks.probes.report_sets import REPORT_SETS, ReportSet
from benchmarks.probes.zero_shot import (
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
)
from uniforce_cli.boundary import command, one_thread
from uniforce_vtla.arguments import choose
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.options import (
    FileName,
    FolderPath,
    Names,
    OutFolder,
    Range,
    Text,
    TokenizerFolder,
)
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.weights import checkpoint_folder
from uniforce_vtla.tokenizer.worn_heads import fit_head

OF_THE_TOKENIZER = {"UniForce", "UniForce (FT)"}  # rows that change with its weights
SHIPPED_HEADS_SET = "zero_shot_v2"  # its sensors are those of the package's heads

Heads = Annotated[int, Range(1, 100)]
ReportSetName = Annotated[str, Names(tuple(REPORT_SETS))]


@dataclass
class TokenizerReportCommand:
    """Measure the table of a frozen set; or freeze a set, or train the shipped heads.

    Example: python -m benchmarks.tokenizer_report set=hetero_hard_v2 seeds=3
    """

    # folder of your own force-labelled recordings in place of a simulated set
    # (docs/data_readers.md)
    data: FolderPath = ""
    # zero_shot_v2 | hetero_hard_v2 | fe_dev_v1 (for choosing) | fe_contacts_v1 (for scoring)
    set: ReportSetName = "zero_shot_v2"
    tokenizer: TokenizerFolder = ""  # checkpoint folder; empty = shipped
    results: OutFolder = "outputs/tokenizer_report"  # tables; with only= also where one is read
    facts: FolderPath = "docs/results"  # the frozen sets' recipes and hashes
    cache: OutFolder = "outputs/labelled"  # drawn sets; delete it after changing contact/
    seeds: Heads = 3  # heads per cell
    freeze: bool = False  # only draw the set and write its hash into results
    # also write tokenizer and heads into the package (set=zero_shot_v2)
    ship: Literal["", "small", "nano"] = ""
    table: FileName = ""  # another name for the table's file; empty = the set's own
    only: Text = ""  # rows to measure, comma between them; the others stay as committed


def freeze(command: TokenizerReportCommand, report_set: ReportSet, side: int) -> Path:
    frozen = report_set.draw(report_set.frozen, report_set.targets(), side, Path(command.cache))
    facts = set_facts(report_set.frozen, frozen)
    return write_json(Path(command.results) / report_set.facts_file, facts | provenance())


def measure(
    command: TokenizerReportCommand, report_set: ReportSet, tokenizer: Tokenizer
) -> dict[str, Any]:
    """Return the table's content; every learnt row is trained here, on the source sensor alone."""
    facts = _facts(command, report_set)
    table = draw_sets(report_set, tokenizer.config.side, Path(command.cache))
    check_frozen(facts, table.frozen)
    if command.ship:
        ship(command.ship, table.training, tokenizer)
    untrained = Tokenizer.random(tokenizer.config)
    seeds = command.seeds
    makers: dict[str, Callable[[], Cells]] = {
        "UniForce": lambda: learnt_row(table, lambda s: encode_set(tokenizer, s), seeds, POOL),
        "hand descriptor": lambda: descriptor_row(table, seeds),
        "random encoder": lambda: learnt_row(
            table, lambda s: encode_set(untrained, s), seeds, POOL
        ),
        "mean": lambda: mean_row(table),
    }
    chosen = choose(makers, command.only)
    committed = _committed_table(command, report_set, facts)  # refused before the work begins
    measured = {}
    for name, make in tqdm(chosen.items(), desc="rows"):
        measured[name] = make()
    rows = _still_true(committed, tokenizer) | measured
    origin = provenance()
    measured_by = committed.get("measured_by", {}) | dict.fromkeys(measured, origin)
    content = {
        "what": "simulated; head trained on the source sensor, seen indenters; "
        "scored on unseen indenters",
        "set": facts["set"],
        "set_hash": facts["set_hash"],
        "seeds": seeds,
        "tokenizer_hash": tokenizer.hash,
        "own_sensor_fz_mae_N": None,
        "summary": {name: summary(row) for name, row in rows.items()},
        "rows": rows,
        "measured_by": {name: by for name, by in measured_by.items() if name in rows},
    }
    if "UniForce" in rows:
        content["own_sensor_fz_mae_N"] = own_sensor_mae(rows["UniForce"], table.training)
    if "speed" in committed:
        content["speed"] = committed["speed"]
    if report_set.name == SHIPPED_HEADS_SET and not command.table:
        content["shipped_heads"] = shipped_row(tokenizer, table)
    return content | origin


def own_sensor_mae(row: Cells, sensors: Iterable[str]) -> float:
    """Return a row's mean |error| of Fz in N on its heads' own sensors: no transfer beats it."""
    own = [row[transfer_name(sensor, sensor)]["mae_N_paper_range"][2] for sensor in sensors]
    return sum(own) / len(own)


def draw_sets(report_set: ReportSet, side: int, cache: Path) -> Table:
    """Return the table's sets: sources with seen indenters, targets with unseen ones."""
    training = report_set.draw(report_set.training, report_set.sources(), side, cache)
    return Table(training, report_set.draw(report_set.frozen, report_set.targets(), side, cache))


def _table_path(command: TokenizerReportCommand, report_set: ReportSet) -> Path:
    return Path(command.results) / (command.table or report_set.table)


def _facts(command: TokenizerReportCommand, report_set: ReportSet) -> dict[str, Any]:
    path = Path(command.facts) / report_set.facts_file
    if not path.exists():
        do = (
            f"Freeze it first: python -m benchmarks.tokenizer_report "
            f"set={report_set.name} freeze=true"
        )
        raise DatasetError(
            expected(str(path), "the frozen set's recipe and hash", "no such file", do)
        )
    return dict(json.loads(path.read_text()))


def _committed_table(
    command: TokenizerReportCommand, report_set: ReportSet, facts: dict[str, Any]
) -> dict[str, Any]:
    """Return the committed table whose rows ``only=`` keeps; empty where nothing is kept.

    Raises DatasetError: a table of another set or other seeds.
    """
    path = _table_path(command, report_set)
    if not command.only or not path.exists():
        return {}
    table = dict(json.loads(path.read_text()))
    came = table["set_hash"], table["seeds"]
    wanted = facts["set_hash"], command.seeds
    if came != wanted:
        raise DatasetError(
            expected("committed table", wanted, came, "Measure all rows: leave out only=.")
        )
    return table


def _still_true(table: dict[str, Any], tokenizer: Tokenizer) -> dict[str, Cells]:
    """Return the rows of a table that hold for ``tokenizer``: all, or those of no tokenizer."""
    rows = dict(table.get("rows", {}))
    if not rows or table["tokenizer_hash"] == tokenizer.hash:
        return rows
    gone = sorted(OF_THE_TOKENIZER & set(rows))
    print(
        f"note: the table is of tokenizer {table['tokenizer_hash']}; "
        f"rows dropped unless measured now: {gone}"
    )
    return {name: row for name, row in rows.items() if name not in OF_THE_TOKENIZER}


def ship(size: str, sources: Iterable[str], tokenizer: Tokenizer) -> None:
    """Write tokenizer and one head per source sensor into the package; heads learn from units."""
    tokenizer.save(checkpoint_folder(size, "tokenizer"))
    for source in sources:
        fit_head(source, tokenizer).save(checkpoint_folder(size, f"force_head_{source}"))


def shipped_row(tokenizer: Tokenizer, table: Table) -> Cells:
    """Return the transfers as the shipped heads do them."""
    cells = {}
    for source, target in table.transfers():
        head = ForceHead.from_pretrained(source)
        cells[transfer_name(source, target)] = shipped_cell(head, tokenizer, table.frozen[target])
    return cells


@command(TokenizerReportCommand)
def main(command: TokenizerReportCommand) -> None:
    logging.basicConfig(level=logging.INFO)
    one_thread()
    report_set = REPORT_SETS[command.set]
    tokenizer = Tokenizer.from_pretrained(command.tokenizer or None)
    if command.freeze:
        print(f"set frozen in {freeze(command, report_set, tokenizer.config.side)}")
        return
    if command.data:
        print(user_data(tokenizer, command.data, command.seeds, Path(command.results)))
        return
    content = measure(command, report_set, tokenizer)
    path = write_json(_table_path(command, report_set), content)
    for name, values in content["summary"].items():
        print(f"{name:16s} " + "  ".join(f"{key} {value:.2f}" for key, value in values.items()))
    print(f"table: {path}")


if __name__ == "__main__":
    sys.exit(main())
