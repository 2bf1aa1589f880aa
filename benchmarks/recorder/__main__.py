"""Try the recorder on stand-ins: whole sessions, kill -9, every fault, and what it costs."""

import dataclasses
import datetime
import json
import logging
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.ledger import Ledger
from benchmarks.recorder.plan import Plan
from uniforce_cli.boundary import command
from uniforce_vtla.arguments import choose
from uniforce_vtla.results_file import provenance, write_json


def try_recorder(plan: Plan) -> dict[str, Any]:
    """Run the chosen parts; return the whole result.

    Raises ContractError: an unknown part or fault; TrialError: a trial outside the faults that
    missed its point.
    """
    from benchmarks.recorder.verdict import bars

    chosen, found = choose(_parts(plan), plan.only), plan.folder / "found"
    if plan.fresh and found.is_dir():  # never a folder that is something else
        shutil.rmtree(plan.folder, ignore_errors=True)
    ledger, out = Ledger(found, _show), Path(plan.out)
    for name, part in chosen.items():
        print(f"recorder_trials: {name}")
        result = json.loads(out.read_text()) if out.is_file() else {}
        result[name] = part(plan, ledger)
        settings = {
            key: v
            for key, v in dataclasses.asdict(plan).items()
            if key not in ("work", "out", "fresh")
        }
        result.setdefault("runs", {})[name] = {"judged": plan.is_judged, **settings, **provenance()}
        result["bars"] = bars(result)
        write_json(out, result)
    whole: dict[str, Any] = json.loads(out.read_text())
    return whole


def _parts(plan: Plan) -> dict[str, Callable[[Plan, Ledger], dict[str, Any]]]:
    from benchmarks.recorder import end_to_end, faults, kill9, overhead

    names = tuple(choose(dict.fromkeys(faults.NAMES), plan.faults))
    return {
        "overhead": overhead.run,
        "end_to_end": end_to_end.run,
        "kill9": kill9.run,
        "faults": lambda plan, ledger: faults.run(plan, ledger, names),
    }


def _show(name: str, number: int, finding: dict[str, Any]) -> None:
    wanted = ("right_outcome", "label", "hold_s", "exit_code", "moment", "victim", "saved_lost")
    said = ", ".join(f"{key} {finding[key]}" for key in wanted if key in finding)
    print(f"  {datetime.datetime.now():%H:%M:%S} {name} {number}: {said or 'done'}", flush=True)


@command(Plan)
def main(plan: Plan) -> int:
    """Entry of ``python -m benchmarks.recorder``; 0 where every bar asked about is met, else 1."""
    logging.basicConfig(level=logging.WARNING)
    result = try_recorder(plan)
    for bar in result["bars"]:
        print(f"{bar['verdict']:12s} {bar['bar']}: asked {bar['asked']}, seen {bar['seen']}")
    print(f"written to {plan.out}")
    return int(any(bar["verdict"] == "missed" for bar in result["bars"]))


if __name__ == "__main__":
    raise SystemExit(main())
