"""Join the scored parts of the plan into one ``wiping.json``: the ladder, its controls, arms, claims and tests.

Claims and tests are of all rows together: parts of one comparison may have been scored one after the other.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.ladder.plan import BETTER, claims
from uniforce_cli.boundary import command
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.comparison import better
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import FilePath, OutFile, Text, split
from uniforce_vtla.results_file import provenance, write_json

CLEAN = "C"  # of EpisodeRow.code
CLAIMABLE = 200  # an arm of fewer rollouts stands aside: no claim rests on it
SECTIONS = {"ladder": "ladder", "left_out": "ladder", "controls": "ladder_controls", "arms": "arms"}
SAME = ("level", "level_hash")
ROWS = ("arms", "side_arms", "ladder", "ladder_controls")


@dataclass
class ReportCommand:
    """Write docs/results/wiping.json from what `python -m benchmarks.ladder` wrote part by part.

    Example: python -m benchmarks.ladder.report parts=outputs/ladder.json,outputs/arms.json out=docs/results/wiping.json
    """

    parts: Text = "outputs/ladder.json"  # result files, comma between them
    # gates.json of the arms' scenes (benchmarks.gates first_seed=…): its best script without touch stands beside them
    blind: FilePath = ""
    onto: FilePath = ""  # an earlier wiping.json that these parts are added to
    out: OutFile = "outputs/wiping.json"


def joined(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return ``wiping.json`` without its claims: rows under their section; ContractError: parts of different levels."""
    first = parts[0]
    for part in parts[1:]:
        _check_level("the parts", first, part)
    found: dict[str, Any] = {key: first[key] for key in SAME}
    found["scored_by"] = [{key: part[key] for key in ("command", "date", "machine")} for part in parts]
    rows = [row for part in parts for row in part["rows"].values()]
    found["training_seeds"] = max(len(row["clean_by_training_seed"]) for row in rows)
    found |= {section: {} for section in ROWS}
    for part in parts:
        section = SECTIONS[part["part"]]
        for name, row in part["rows"].items():
            aside = section == "arms" and row["n"] < CLAIMABLE
            key = name.replace(" ", "_") if section == "ladder" else name
            found["side_arms" if aside else section][key] = row
    return found


def _check_level(whose: str, first: dict[str, Any], other: dict[str, Any]) -> None:
    if came := {key: other[key] for key in SAME if other[key] != first[key]}:
        wanted = {key: first[key] for key in came}
        raise ContractError(expected(f"level of {whose}", wanted, came, "Score them on one level."))


def added(found: dict[str, Any], earlier: dict[str, Any]) -> dict[str, Any]:
    """Return an earlier report with these rows beside its own; ContractError: of another level."""
    _check_level("the earlier report", found, earlier)
    rows = {section: earlier[section] | found[section] for section in ROWS}
    return earlier | rows | {"scored_by": earlier["scored_by"] + found["scored_by"]}


def add_best_blind(found: dict[str, Any], gates: dict[str, Any]) -> None:
    """Put the script without touch that wipes clean most often beside the arms.

    Raises ContractError: another level or other scenes than V+T's.
    """
    scored, with_touch = [gates["level_hash"], *gates["seeds"]], found["arms"]["V+T"]
    wanted = [found["level_hash"], *with_touch["seeds"]]
    if scored != wanted:
        raise ContractError(expected("level and scenes of the blind", wanted, scored, "Run them on the arms' scenes."))
    blind = gates["must_fail"]
    name = max(blind, key=lambda name: blind[name]["clean"])
    found["arms"]["best blind"] = {"script": name, "seeds": gates["seeds"], **blind[name]}


def named_rows(found: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each row of every section under its name in the plan; arms and side arms may share one."""
    for section in ROWS:
        for key, row in found[section].items():
            yield key.replace("_", " "), row


def codes(row: dict[str, Any]) -> dict[int, str]:
    """Return the code of how each rollout of a row ended, by its scene's seed."""
    first, last = row["seeds"]
    return dict(zip(range(first, last + 1), row["by_seed"], strict=True))


def clean_by_seed(found: dict[str, Any]) -> dict[str, dict[int, bool]]:
    """Return whether each rollout was clean, by the row's name in the plan and the scene's seed."""
    arms: dict[str, dict[int, bool]] = {}
    for name, row in named_rows(found):
        arms.setdefault(name, {}).update({seed: code == CLEAN for seed, code in codes(row).items()})
    return arms


def judged(found: dict[str, Any]) -> dict[str, Any]:
    """Return the report with the plan's claims and tests, each of the scenes that both of its rows share."""
    arms = clean_by_seed(found)
    return found | {"within": claims(arms), "tests": better(arms, BETTER)}


@command(ReportCommand)
def main(config: ReportCommand) -> None:
    content = joined([read_object(Path(part), ContractError) for part in split(config.parts)])
    if config.blind:
        add_best_blind(content, read_object(Path(config.blind), ContractError))
    if config.onto:
        content = added(content, read_object(Path(config.onto), ContractError))
    path = write_json(Path(config.out), judged(content) | provenance())
    rows = sum(len(content[section]) for section in ROWS)
    print(f"{rows} rows written to {path}")


if __name__ == "__main__":
    sys.exit(main())
