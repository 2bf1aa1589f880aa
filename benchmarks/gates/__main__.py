"""Gates of a level: what must wipe it, what must not, each on the same fresh scenes."""

import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from joblib import delayed

from benchmarks.gates.blind import BlindScript, BlindSettings, MeasuredPress
from benchmarks.gates.fitting import PRESSES_N, STYLES, Fitted, fit
from benchmarks.gates.observer import Observed
from benchmarks.gates.readings import EverySixth, Frozen, PlaneKnown, ReadingExpert, scaled, shifted
from benchmarks.gates.scripts import HarderEachLook, KeepingExpert, LagIdentifying
from benchmarks.ledger import played
from benchmarks.scene_blocks import BLOCKS
from benchmarks.stress.row import Row, row_of
from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import Script, run_script
from lerobot_env_uniforce_wiping.levels import Layout, get_level, level_hash
from uniforce_cli.boundary import Gripper, Level, command, one_thread, worker_process
from uniforce_vtla.arguments import choose
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.options import Count, OutFile, OutFolder, Seed, Text, Workers
from uniforce_vtla.results_file import provenance, write_json

# forces as they are wanted: this script knows the stiffness
WANTED = BlindSettings(press_N=6.0, grip_N=8.5)


@dataclass(frozen=True)
class Gate:
    """One script and the share of clean wipes it must reach, or must not exceed."""

    make: Callable[[Fitted, Path], Script]
    at_least: float | None = None
    at_most: float | None = None

    def holds(self, clean: float) -> bool:
        """Return whether the level may be used, as far as this script goes."""
        if self.at_least is not None and clean < self.at_least:
            return False
        return self.at_most is None or clean <= self.at_most


def _lag_identifying(fitted: Fitted, folder: Path) -> Script:
    def style(layout: Layout, settings: BlindSettings) -> LagIdentifying:
        regulator = LagIdentifying(layout, settings)
        regulator.laws = (fitted.arm, fitted.gripper)
        return regulator

    return BlindScript(WANTED, style)


def _blind(style: str, fitted: Fitted, folder: Path) -> Script:
    return BlindScript(fitted.set_points[style], STYLES[style][0])


def _reads(change: Callable[[Fitted, Path], Callable[[], Any]], **bars: float) -> Gate:
    return Gate(lambda fitted, folder: ReadingExpert(change(fitted, folder)), **bars)


def _always(make: Callable[[], Script], **bars: float) -> Gate:
    return Gate(lambda fitted, folder: make(), **bars)


GATES: dict[str, Gate] = {
    "expert": _always(WipeExpert, at_least=0.97),
    "touch every sixth step": _reads(lambda f, p: EverySixth, at_least=0.88),
    "reads × .9": _reads(lambda f, p: partial(scaled, 0.9), at_least=0.90),
    "reads × 1.1": _reads(lambda f, p: partial(scaled, 1.1), at_least=0.90),
    "reads × .7": _reads(lambda f, p: partial(scaled, 0.7), at_most=0.15),
    "reads × 1.4": _reads(lambda f, p: partial(scaled, 1.4), at_most=0.15),
    "reads 2 N less": _reads(lambda f, p: partial(shifted, -2.0), at_most=0.15),
    "reads 2 N more": _reads(lambda f, p: partial(shifted, 2.0), at_most=0.15),
    "open loop": Gate(partial(_blind, "open loop"), at_most=0.15),
    "measured press": Gate(partial(_blind, "measured press"), at_most=0.15),
    "measured relative": Gate(partial(_blind, "measured relative"), at_most=0.15),
    "lag identifying": Gate(_lag_identifying, at_most=0.15),
    "harder each look": Gate(
        lambda f, p: HarderEachLook(
            replace(f.set_points["measured press"], press_N=PRESSES_N[0]), MeasuredPress
        ),
        at_most=0.15,
    ),
    "plane known": _reads(
        lambda f, p: partial(PlaneKnown, f.plane_stiffness_N_m, f.plane_rest_m), at_most=0.15
    ),
    "observer of pose and commands": _reads(
        lambda f, p: partial(Observed, p / "observer.pt", False), at_most=0.15
    ),
    "observer that sees the ink": _reads(
        lambda f, p: partial(Observed, p / "observer_ink.pt", True), at_most=0.20
    ),
    "frozen touch": _reads(lambda f, p: Frozen, at_most=0.20),
    "keeps depth": _always(partial(KeepingExpert, False), at_most=0.20),
    "keeps height": _always(partial(KeepingExpert, True), at_most=0.20),
}


@dataclass
class GatesCommand:
    """Run every script on the same scenes; say which gates hold; write gates.json.

    Example: python -m benchmarks.gates level=touch episodes=100 first_seed=1000000
    """

    level: Level = "touch"
    gripper: Gripper = "hand"  # of the scene
    episodes: Count = 100  # scenes, the same for every script
    first_seed: Seed = BLOCKS["gates"].start  # of them
    learn_from: Count = 250  # scenes that lag laws and observers are fitted on
    sweep_on: Count = 15  # of them that set points of scripts without touch are chosen on
    learn_seed: Seed = BLOCKS["what scripts of the gates learn from"].start  # where these start
    only: Text = ""  # these scripts, comma between them
    workers: Workers = 2
    work: OutFolder = "outputs/gates"  # what was learnt, and episodes so far: run it again to go on
    out: OutFile = "outputs/gates.json"


def play(level: str, gripper: str, name: str, seed: int, fitted: Fitted, folder: Path) -> Row:
    """Let a script act in one scene."""
    worker_process()
    env = WipeEnv(level=level, drawn=(), gripper=gripper)
    return row_of(name, env, run_script(env, GATES[name].make(fitted, folder), seed))


def run_all(config: GatesCommand, fitted: Fitted) -> list[dict[str, Any]]:
    """Return a row per script and scene; those of an earlier run are kept."""
    folder = Path(config.work)
    rig: str = config.level
    if config.gripper == "hand":
        rig += "_hand"
    path = folder / f"{rig}_{level_hash(get_level(config.level))}_{config.first_seed}_rows.jsonl"
    seeds = range(config.first_seed, config.first_seed + config.episodes)
    episodes = []
    for seed in seeds:
        for name in choose(GATES, config.only):
            job = delayed(play)(config.level, config.gripper, name, seed, fitted, folder)
            episodes.append((name, seed, job))
    rows = played(path, episodes, config.workers)
    return [row for row in rows if row["seed"] in seeds]


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a line per script that was run; ``by_seed`` as in an arm's (``EpisodeRow.code``)."""
    by_script: dict[str, list[dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda row: row["seed"]):
        by_script.setdefault(row["cell"], []).append(row)
    found = {}
    for name, gate in GATES.items():
        if name not in by_script:
            continue
        own = by_script[name]
        clean = sum(row["clean"] for row in own)
        interval = wilson(clean, len(own))
        found[name] = {
            "n": len(own),
            "clean": clean,
            "wilson95": [interval.low, interval.high],
            "at_least": gate.at_least,
            "at_most": gate.at_most,
            "holds": gate.holds(clean / len(own)),
            "in_band_share": sum(row["in_band_share"] for row in own) / len(own),
            "success": sum(row["outcome"] == "success" for row in own),
            "by_seed": "".join("C" if row["clean"] else row["outcome"][0] for row in own),
        }
    return found


@command(GatesCommand)
def main(config: GatesCommand) -> None:
    one_thread()
    scenes = config.learn_from, config.sweep_on, config.learn_seed
    fitted = fit(config.level, config.gripper, *scenes, config.workers, Path(config.work))
    scripts = summarise(run_all(config, fitted))
    must_pass = {}
    must_fail = {}
    for name, line in scripts.items():
        if line["at_least"] is not None:
            must_pass[name] = line
            bar = f"≥ {line['at_least']}"
        else:
            must_fail[name] = line
            bar = f"≤ {line['at_most']}"
        verdict = "holds" if line["holds"] else "DOES NOT HOLD"
        print(f"{name:32} {line['clean']:3}/{line['n']}  {bar:7} {verdict}")
    content = {
        "level": config.level,
        "gripper": config.gripper,
        "level_hash": level_hash(get_level(config.level)),
        "seeds": [config.first_seed, config.first_seed + config.episodes - 1],
        "learnt_on": [config.learn_seed, config.learn_seed + config.learn_from - 1],
        "fitted": asdict(fitted),
        "all_hold": all(line["holds"] for line in scripts.values()),
        "must_pass": must_pass,
        "must_fail": must_fail,
    }
    print(f"written to {write_json(Path(config.out), content | provenance())}")


if __name__ == "__main__":
    sys.exit(main())
