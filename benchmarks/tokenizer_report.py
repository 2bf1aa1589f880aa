"""Worth of the tokenizer: zero-shot force on frozen sets, charts, real recordings."""

import json
import logging
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tqdm import tqdm

from benchmarks.baselines.finetuned import finetuned_row
from benchmarks.baselines.resnet import resnet_row
from benchmarks.baselines.speed import speed_report
from benchmarks.probes.labelled_set import LabelledSet, set_facts
from benchmarks.probes.latent_and_pictures import latent_correlation, reconstructions
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
    CountOrZero,
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

PICTURED = 64  # pairs per rig that are redrawn
REPLAY_TOLERANCE = 0.01  # R²; the same images and weights on another CPU differ far less
OF_THE_TOKENIZER = {"UniForce", "UniForce (FT)"}  # rows that change with its weights
# its sensors are the registry's, which is what the package's heads are for
SHIPPED_HEADS_SET = "zero_shot_v2"


Heads = Annotated[int, Range(1, 100)]
ReportSetName = Annotated[str, Names(tuple(REPORT_SETS))]


@dataclass
class TokenizerReportCommand:
    """Answer one question about a tokenizer; or freeze a set, train the shipped heads, replay a committed table.

    Example: python -m benchmarks.tokenizer_report question=force set=hetero_hard_v2 seeds=3
    """

    # force (Q3) | correlation of the latent with force (Q1) | reconstruction (Q2)
    question: Literal["force", "correlation", "reconstruction"] = "force"
    # folder of your own force-labelled recordings instead of a simulated set (docs/data_readers.md)
    data: FolderPath = ""
    # zero_shot_v2 | hetero_hard_v2 | fe_dev_v1 (for choosing) | fe_contacts_v1 (for scoring)
    set: ReportSetName = "zero_shot_v2"
    tokenizer: TokenizerFolder = ""  # checkpoint folder; empty = shipped
    # tables; of replay and only: where the table is read
    results: OutFolder = "outputs/tokenizer_report"
    # the frozen sets' recipes and hashes; freeze writes into results
    facts: FolderPath = "docs/results"
    # drawn sets, kept for the next run; delete it after changing contact/
    cache: OutFolder = "outputs/labelled"
    seeds: Heads = 3  # heads per cell
    freeze: bool = False  # only draw the set and write its hash
    # also write tokenizer and heads into the package (set=zero_shot_v2)
    ship: Literal["", "small", "nano"] = ""
    table: FileName = ""  # another name for the table's file; empty = the set's own
    # also the rows that train networks of their own: hours on two cores, one row at a time
    baselines: bool = False
    # measure just these rows (comma between them), keep the others from the committed table
    only: Text = ""
    # only re-measure so many cells of the UniForce row, or of the shipped heads, and compare
    replay: CountOrZero = 0


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
    if command.baselines:
        makers |= trained(table, tokenizer, seeds)
    chosen = choose(makers, command.only)
    # refuses one that does not fit before the work begins
    _committed_table(command, report_set, facts)
    measured = {name: make() for name, make in tqdm(chosen.items(), desc="rows")}
    # once more: another row may have come in meanwhile
    committed = _committed_table(command, report_set, facts)
    rows = _still_true(committed, tokenizer) | measured
    # in the committed table's order, so that pictures keep theirs
    rows = {
        name: rows[name]
        for name in dict.fromkeys([*committed.get("rows", {}), *rows])
        if name in rows
    }
    origins = {name: by for name, by in committed.get("measured_by", {}).items() if name in rows}
    origin = provenance()
    content = {
        "what": "simulated; head trained on the source sensor, seen indenters; scored on unseen indenters",
        "set": facts["set"],
        "set_hash": facts["set_hash"],
        "seeds": seeds,
        "tokenizer_hash": tokenizer.hash,
        "own_sensor_fz_mae_N": own_sensor_mae(rows["UniForce"], table.training)
        if "UniForce" in rows
        else None,
        "summary": {name: summary(row) for name, row in rows.items()},
        "rows": rows,
        "measured_by": origins | dict.fromkeys(measured, origin),
    }
    content |= {"speed": committed["speed"]} if "speed" in committed else {}
    if command.baselines:
        content["speed"] = speed_report(tokenizer)["encoders"]
    if report_set.name == SHIPPED_HEADS_SET and not command.table:
        content["shipped_heads"] = shipped_row(tokenizer, table, len(table.transfers()))
    return content | origin


def trained(table: Table, tokenizer: Tokenizer, seeds: int) -> dict[str, Callable[[], Cells]]:
    """Return the makers of rows that train networks: name → maker."""
    return {
        "UniForce (FT)": lambda: finetuned_row(table, tokenizer, seeds),
        "ResNet": lambda: resnet_row(table, seeds),
    }


def own_sensor_mae(row: Cells, sensors: Iterable[str]) -> float:
    """Return a row's mean |error| of Fz on the sensors its heads were trained on: what no transfer can beat."""
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
        do = f"Freeze it first: python -m benchmarks.tokenizer_report set={report_set.name} freeze=true"
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
    table = json.loads(path.read_text())
    came, wanted = (table["set_hash"], table["seeds"]), (facts["set_hash"], command.seeds)
    if came != wanted:
        raise DatasetError(
            expected("committed table", wanted, came, "Measure all rows: leave out only=.")
        )
    return dict(table)


def _still_true(table: dict[str, Any], tokenizer: Tokenizer) -> dict[str, Cells]:
    """Return a table's rows that hold for ``tokenizer``: after a new one, those that never saw the old one."""
    rows = dict(table.get("rows", {}))
    if not rows or table["tokenizer_hash"] == tokenizer.hash:
        return rows
    gone = sorted(OF_THE_TOKENIZER & set(rows))
    print(
        f"note: the table is of tokenizer {table['tokenizer_hash']}; rows dropped unless measured now: {gone}"
    )
    return {name: row for name, row in rows.items() if name not in OF_THE_TOKENIZER}


def ship(size: str, sources: Iterable[str], tokenizer: Tokenizer) -> None:
    """Write the tokenizer and one head per source sensor into the package; heads learn from worn units."""
    tokenizer.save(checkpoint_folder(size, "tokenizer"))
    for source in sources:
        fit_head(source, tokenizer).save(checkpoint_folder(size, f"force_head_{source}"))


def shipped_row(tokenizer: Tokenizer, table: Table, count: int) -> Cells:
    """Return the first ``count`` transfers as the shipped heads do them."""
    cells = {}
    for source, target in table.transfers()[:count]:
        head = ForceHead.from_pretrained(source)
        cells[transfer_name(source, target)] = shipped_cell(head, tokenizer, table.frozen[target])
    return cells


def replay(command: TokenizerReportCommand, report_set: ReportSet, tokenizer: Tokenizer) -> float:
    """Re-measure cells from the shipped weights; return the largest difference of R² to the committed table.

    ``zero_shot_v2`` replays the shipped heads; the other sets train their heads again from the same seeds.
    """
    table = draw_sets(report_set, tokenizer.config.side, Path(command.cache))
    _say_if_redrawn(command, report_set, table.frozen)
    committed = json.loads((_table_path(command, report_set)).read_text())
    if report_set.name == SHIPPED_HEADS_SET:
        again, before = shipped_row(tokenizer, table, command.replay), committed["shipped_heads"]
    else:
        again = learnt_row(table, lambda s: encode_set(tokenizer, s), committed["seeds"], POOL)
        names = [transfer_name(a, b) for a, b in table.transfers()[: command.replay]]
        again, before = {name: again[name] for name in names}, committed["rows"]["UniForce"]
    return max(
        abs(x - y)
        for name in again
        for x, y in zip(again[name]["r2"], before[name]["r2"], strict=True)
    )


def _say_if_redrawn(
    command: TokenizerReportCommand, report_set: ReportSet, frozen: dict[str, LabelledSet]
) -> None:
    """Another CPU may round a marker's edge otherwise: the numbers must still agree, so go on, but say so."""
    try:
        check_frozen(_facts(command, report_set), frozen)
    except DatasetError as error:
        print(f"note: {error}")


def _report(command: TokenizerReportCommand) -> str:
    results, report_set = Path(command.results), REPORT_SETS[command.set]
    tokenizer = Tokenizer.from_pretrained(command.tokenizer or None)
    if command.freeze:
        return f"set frozen in {freeze(command, report_set, tokenizer.config.side)}"
    if command.replay:
        worst = replay(command, report_set, tokenizer)
        verdict = "agrees with" if worst <= REPLAY_TOLERANCE else "DIFFERS FROM"
        path = _table_path(command, report_set)
        return f"replay of {command.replay} cells {verdict} {path}: largest difference {worst:.4f}"
    if command.data:
        return user_data(tokenizer, command.data, command.seeds, results)
    if command.question in ("correlation", "reconstruction"):
        return _latent_or_pictures(command, report_set, tokenizer)
    content = measure(command, report_set, tokenizer)
    path = write_json(_table_path(command, report_set), content)
    lines = [
        f"{name:16s} " + "  ".join(f"{key} {value:.2f}" for key, value in values.items())
        for name, values in content["summary"].items()
    ]
    return "\n".join([*lines, f"table: {path}"])


def _latent_or_pictures(
    command: TokenizerReportCommand, report_set: ReportSet, tokenizer: Tokenizer
) -> str:
    results = Path(command.results)
    if command.question == "correlation":
        table = draw_sets(report_set, tokenizer.config.side, Path(command.cache))
        found, name = (
            latent_correlation(tokenizer, table) | {"set": report_set.name},
            "latent_correlation.json",
        )
    else:
        found, name = (
            reconstructions(tokenizer, PICTURED, results / "reconstruction.png"),
            "reconstruction.json",
        )
    found |= {"tokenizer_hash": tokenizer.hash}
    return f"written to {write_json(results / name, found | provenance())}"


@command(TokenizerReportCommand)
def main(command: TokenizerReportCommand) -> None:
    logging.basicConfig(level=logging.INFO)
    one_thread()
    print(_report(command))


if __name__ == "__main__":
    sys.exit(main())
