"""Find where it breaks: curves of clean wipes against a fault's dose, three actors, same scenes."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joblib import delayed
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.figures import OTHER, SENSOR_COLOURS, percent
from benchmarks.ladder.plan import LEVEL
from benchmarks.ledger import played
from benchmarks.scene_blocks import BLOCKS
from benchmarks.stress.actors import ACTORS, play
from benchmarks.stress.faults import FAULTS
from lerobot_env_uniforce_wiping import LEVELS, level_hash
from uniforce_cli.boundary import command, one_thread
from uniforce_cli.score import content_of
from uniforce_vtla.arguments import choose
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import Count, FolderPath, OutFile, OutFolder, Text, Workers
from uniforce_vtla.results_file import provenance, write_json

# all feel with a TacTip: its colour, a paler one, and that of what is no policy
COLOURS = dict(zip(ACTORS, (SENSOR_COLOURS["TacTip"], "#89c2d9", OTHER), strict=True))


@dataclass
class StressCommand:
    """Roll three actors out under faults in rising doses; write and draw the curves.

    Example: python -m benchmarks.stress scenes=30
    """

    checkpoints: FolderPath = (
        "benchmarks/ladder/checkpoints"  # holds latent/seed0 …, which take turns
    )
    scenes: Count = 30  # the same for every actor and dose
    only: Text = ""  # faults, comma between them; "" = all
    actors: Text = ""  # comma between them; "" = all
    workers: Workers = 2
    # calibrations, and episodes so far: run it again to go on
    work: OutFolder = "outputs/stress"
    out: OutFile = "outputs/curves.json"  # the result file; its figure lies beside it


def seeds_of(config: StressCommand) -> range:
    """Return the scenes."""
    first = BLOCKS["curves"].start
    return range(first, first + config.scenes)


def cells_of(config: StressCommand) -> list[tuple[str, str, float]]:
    """Return actor, fault and dose of every cell; the fault "" is none."""
    chosen = choose(FAULTS, config.only)
    cells = []
    for actor in choose(ACTORS, config.actors):
        cells.append((actor, "", 0.0))
        for name in chosen:
            for dose in FAULTS[name].doses:
                cells.append((actor, name, dose))
    return cells


def cell_name(actor: str, fault: str, dose: float) -> str:
    """Return the name of a cell in the ledger."""
    return f"{actor}, {fault} {dose:g}" if fault else actor


def episodes(config: StressCommand, policies: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
    """Yield each episode for ``played``: every cell acts in a scene before any in the next."""
    work = Path(config.work)
    for turn, seed in enumerate(seeds_of(config)):
        policy = policies[turn % len(policies)]
        for actor, fault, dose in cells_of(config):
            name = cell_name(actor, fault, dose)
            yield name, seed, delayed(play)(name, actor, policy, fault, dose, seed, work)


def curves(rows: Sequence[Mapping[str, Any]], seeds: range) -> dict[str, dict[str, Any]]:
    """Return by actor and fault the doses, the one without the fault first, and clean of n."""
    clean: dict[str, list[bool]] = {}
    for row in rows:
        if row["seed"] in seeds:
            clean.setdefault(row["cell"], []).append(row["clean"])
    found: dict[str, dict[str, Any]] = {}
    for actor in ACTORS:
        for name, fault in FAULTS.items():
            here = [clean.get(actor, [])]
            for dose in fault.doses:
                here.append(clean.get(cell_name(actor, name, dose), []))
            if any(here[1:]):
                found.setdefault(actor, {})[name] = {
                    "doses": [fault.none, *fault.doses],
                    "clean": list(map(sum, here)),
                    "n": list(map(len, here)),
                }
    return found


def draw(found: Mapping[str, Mapping[str, Any]], path: Path) -> Path:
    """Draw a panel per fault, in it a line per actor with 95 % intervals."""
    names = [name for name in FAULTS if any(name in of_actor for of_actor in found.values())]
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(3.6 * columns, 2.8 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True).flat
    for axes, name in zip(panels, names, strict=False):
        for actor, of_actor in found.items():
            if name in of_actor:
                _draw_line(axes, of_actor[name], COLOURS[actor], actor)
        axes.set(title=name, xlabel=FAULTS[name].axis, ylim=(-2, 102))
        axes.grid(alpha=0.3)
    axes = figure.axes[0]
    axes.set_ylabel("clean wipes, %")
    axes.legend(frameon=False, fontsize=8)
    return save_figure(figure, path)


def _draw_line(axes: Axes, row: Mapping[str, Any], colour: str, label: str) -> None:
    points = []
    for dose, clean, n in zip(row["doses"], row["clean"], row["n"], strict=True):
        if n:
            points.append((dose, *percent(clean, n)))
    doses, middles, below, above = zip(*sorted(points), strict=True)
    axes.errorbar(doses, middles, (below, above), fmt="o-", color=colour, capsize=2, label=label)


def policies_of(config: StressCommand) -> list[str]:
    """Return the checkpoints, and note in the ledger's folder which they are.

    Raises CheckpointError: there are none. ContractError: the ledger's episodes are of others.
    """
    found = sorted(map(str, Path(config.checkpoints).glob("latent/seed*")))
    if not found:
        do = "Train them into it, as docs/experiments/swap.md says."
        raise CheckpointError(expected(config.checkpoints, "latent/seed0 …", "none", do))
    now = {"policies": [content_of(policy) for policy in found]}
    path = Path(config.work) / "acts.json"
    if path.is_file() and read_object(path, ContractError) != now:
        do = "Name another folder: work=…"
        raise ContractError(
            expected(f"episodes in {config.work}", "of these policies", "of other ones", do)
        )
    write_json(path, now)
    return found


@command(StressCommand)
def main(config: StressCommand) -> None:
    one_thread()
    policies = policies_of(config)
    ledger = Path(config.work) / "episodes.jsonl"
    rows = played(ledger, episodes(config, policies), config.workers)
    seeds = seeds_of(config)
    found = curves(rows, seeds)
    for actor, of_actor in found.items():
        for name, row in of_actor.items():
            words = [f"{d:g}: {c}/{n}" for d, c, n in zip(*row.values(), strict=True)]
            print(f"{actor:26} {name:20} {'  '.join(words)}")
    content = {"level": LEVEL, "level_hash": level_hash(LEVELS[LEVEL])}
    content |= {"seeds": [seeds[0], seeds[-1]], "actors": found} | provenance()
    path = write_json(Path(config.out), content)
    print(f"written to {path} and {draw(found, path.with_suffix('.png'))}")


if __name__ == "__main__":
    sys.exit(main())
