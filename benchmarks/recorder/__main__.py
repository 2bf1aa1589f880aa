"""Try the recorder against stand-ins: whole sessions, kill -9, every fault, and what recording costs."""

from __future__ import annotations

import dataclasses
import datetime
import json
import logging
import shutil
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from uniforce_cli.boundary import command
from uniforce_vtla.arguments import choose
from uniforce_vtla.options import Count, Names, OutFile, OutFolder, Positive, Range, Text
from uniforce_vtla.results_file import provenance, write_json

if TYPE_CHECKING:
    from benchmarks.recorder.ledger import Ledger
    from benchmarks.recorder.plan import Plan


Parts = Annotated[str, Names(("end_to_end", "kill9", "faults", "overhead"), many=True)]
Fps = Annotated[int, Range(1, 120)]


@dataclass
class TrialsConfig:
    """Record, kill and break, and write what came of it to a file; run it again to go on.

    Everything, on a machine with nothing else to do:  python -m benchmarks.recorder
    One part, for example:                             python -m benchmarks.recorder only=faults faults=arm_reflex
    On a busy machine, to see that it works:           python -m benchmarks.recorder fps=5 patience=20 uskin_hz=50 …
    Needs the extra `franka`. The arm, fingers and cameras are stand-ins; nothing here is hardware.
    """

    only: Parts = ""  # end_to_end | kill9 | faults | overhead, comma between; empty = all
    faults: Text = ""  # of faults: only these, comma between
    episodes: Count = 50  # of the end to end run
    episode_s: Positive = 4.0  # s, each of them
    kills: Count = 20  # with kill -9
    times: Count = 10  # each fault is injected
    overhead_s: Positive = 30.0  # s, how long cost is measured
    uskin_s: Positive = 60.0  # s, how long the taxels' full rate is measured
    fps: Fps = 30  # ticks and camera frames per second; below 30 no bar is judged
    # what limits of age and waiting times are multiplied by; above 1 no bar is judged
    patience: Positive = 1.0
    uskin_hz: Positive = 500.0  # scans per second of the finger in the rig
    fresh: bool = False  # forget what earlier runs found
    work: OutFolder = "outputs/recorder_trials"  # datasets, logs, findings so far
    out: OutFile = "outputs/recorder.json"  # result file; parts not run keep what it says


def try_recorder(config: TrialsConfig) -> dict[str, Any]:
    """Run the chosen parts; return the whole result.

    Raises:
        ContractError: an unknown part or fault.
        TrialError: a trial that didn't come to its point outside the faults, which note it and go on.
    """
    from benchmarks.recorder.ledger import Ledger
    from benchmarks.recorder.verdict import bars

    chosen = choose(_parts(config), config.only)
    work = Path(config.work)
    if config.fresh and (work / "found").is_dir():  # never a folder that is something else
        shutil.rmtree(work, ignore_errors=True)
    plan, ledger, out = _plan(config), Ledger(work / "found", _show), Path(config.out)
    for name, part in chosen.items():
        print(f"recorder_trials: {name}")
        result = json.loads(out.read_text()) if out.is_file() else {}
        result[name] = part(plan, ledger)
        result.setdefault("runs", {})[name] = {"judged": plan.is_judged, **_settings(config), **provenance()}
        result["bars"] = bars(result)
        write_json(out, result)
    whole: dict[str, Any] = json.loads(out.read_text())
    return whole


def _parts(config: TrialsConfig) -> dict[str, Callable[[Plan, Ledger], dict[str, Any]]]:
    from benchmarks.recorder import end_to_end, faults, kill9, overhead

    names = tuple(choose(dict.fromkeys(faults.NAMES), config.faults))
    return {
        "overhead": overhead.run,
        "end_to_end": end_to_end.run,
        "kill9": kill9.run,
        "faults": lambda plan, ledger: faults.run(plan, ledger, names),
    }


def _plan(config: TrialsConfig) -> Plan:
    from benchmarks.recorder.plan import Plan

    settings = {f.name: getattr(config, f.name) for f in dataclasses.fields(Plan) if hasattr(config, f.name)}
    return Plan(**settings | {"work": Path(config.work).resolve()})


def _settings(config: TrialsConfig) -> dict[str, Any]:
    return {key: value for key, value in dataclasses.asdict(config).items() if key not in ("work", "out", "fresh")}


def _show(name: str, number: int, finding: dict[str, Any]) -> None:
    wanted = ("right_outcome", "label", "hold_s", "exit_code", "moment", "victim", "saved_lost")
    said = ", ".join(f"{key} {finding[key]}" for key in wanted if key in finding)
    print(f"  {datetime.datetime.now():%H:%M:%S} {name} {number}: {said or 'done'}", flush=True)


@command(TrialsConfig)
def main(config: TrialsConfig) -> int:
    """Entry of ``python -m benchmarks.recorder``; 0 where every bar asked about is met, 1 where one isn't."""
    logging.basicConfig(level=logging.WARNING)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # stand-ins and sessions are ended too
    result = try_recorder(config)
    for bar in result["bars"]:
        print(f"{bar['verdict']:12s} {bar['bar']}: asked {bar['asked']}, seen {bar['seen']}")
    print(f"written to {config.out}")
    return int(any(bar["verdict"] == "missed" for bar in result["bars"]))


if __name__ == "__main__":
    raise SystemExit(main())
