"""All stages on a laptop: record, train, roll out with trained and swapped sensors, score, show."""

import contextlib
import logging
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from uniforce_cli.boundary import Level, command
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.options import Count, OutFolder
from uniforce_vtla.results_file import provenance, write_json

MARKER = "uniforce_demo.json"  # in a folder that the next demo may empty
LOG = "demo.log"  # what the steps and their libraries print
TAIL = 15  # of its lines are shown where a step fails


@dataclass
class DemoConfig:
    """Run every stage once, small: no robot, no GPU, four minutes on two cores.

    Example: uniforce demo rollouts=2 out=outputs/demo
    """

    episodes: Count = 2  # demos to record; enough to see every stage, too few to learn from
    # training steps on those demos; they show that training runs, not what it can reach
    train_steps: Count = 20
    rollouts: Count = 2  # scenes per sensor, with the shipped policy; a smoke test, no claim
    level: Level = "touch"  # level of the scene; the shipped policy was trained at touch
    out: OutFolder = "outputs/demo"  # everything goes here; an earlier demo there is replaced


FIRST_SCENE = 10_001  # it is filmed; picked, since the shipped policy wipes it clean with each
# arm → sensor on the right finger; the shipped policy was trained with a TacTip there
ARMS = {"TacTip": "tactip", "uSkin": "uskin", "GelSight": "gelsight"}
SHOWN_AS = {
    "tactip": "TacTip, with which it learnt",
    "uskin": "uSkin instead",
    "gelsight": "GelSight instead",
}


class ProgressBars:
    """A stream that shows progress bars on one line of a terminal and writes all else to a log."""

    def __init__(self, terminal: TextIO, log: TextIO) -> None:
        self._terminal = terminal
        self._log = log

    def write(self, text: str) -> int:
        """Sort a text by how it begins: a bar returns to the start of its line."""
        if text.startswith("\r"):
            self._terminal.write(text)
        elif text.strip():
            self._log.write(text)
        elif text:  # a line's end: the bar is done, and the next one takes its line
            self._terminal.write("\r\x1b[K")
        return len(text)

    def flush(self) -> None:
        self._terminal.flush()
        self._log.flush()

    def isatty(self) -> bool:
        return self._terminal.isatty()


@contextlib.contextmanager
def logged(path: Path) -> Iterator[Callable[[str], None]]:
    """Send all output, of child processes too, into a file; yield a print function for people.

    On a terminal progress bars stay, on one line. If the block fails, the log's last lines and its
    path are printed.
    """
    handlers = list(logging.root.handlers)
    stdout = sys.stdout
    sys.stdout.flush()
    sys.stderr.flush()
    kept = (os.dup(1), os.dup(2))
    with path.open("w", buffering=1) as log, os.fdopen(os.dup(1), "w", buffering=1) as terminal:
        out = terminal if stdout is sys.__stdout__ else stdout
        errors = ProgressBars(terminal, log) if terminal.isatty() else log
        for number in (1, 2):
            os.dup2(log.fileno(), number)
        try:
            with (
                contextlib.redirect_stdout(log),
                contextlib.redirect_stderr(errors),  # type: ignore[type-var]
            ):
                yield lambda text: print(text, file=out, flush=True)
        finally:
            if isinstance(sys.exception(), Exception):
                tail = path.read_text().splitlines()[-TAIL:]
                tail.append(f"the step failed; all it printed is in {path}")
                print("\n".join(tail), file=out, flush=True)
            elif sys.exception() is not None:
                print(f"\nstopped: the next demo begins anew. Log: {path}", file=out, flush=True)
            for number, copy in enumerate(kept, start=1):
                os.dup2(copy, number)
                os.close(copy)
            logging.root.handlers[:] = handlers


def run(config: DemoConfig) -> None:
    start = time.perf_counter()
    out = Path(config.out)
    _start_over(out)
    with logged(out / LOG) as say:
        page = _steps(config, out, say)
        minutes = (time.perf_counter() - start) / 60
        say(f"\nDone in {minutes:.1f} minutes (n = {config.rollouts}: smoke, no claim).")
        say(f"  look at it     {page}   (the same scene with each sensor: open it in a browser)")
        say(f"  a demo         {out / 'show' / 'episode_0.html'}")
        say(f"  demos          {out / 'demos'}   (LeRobot v3 dataset)")
        trained = out / "train" / "checkpoints" / "last"
        say(f"  trained        {trained}   ({config.train_steps} steps: not what was scored)")
        say(f"  scores         {out / 'wiping.json'}")
        say(f"  log            {out / LOG}")


def _steps(config: DemoConfig, out: Path, say: Callable[[str], None]) -> Path:
    """Run every stage; return the page that plays each sensor's rollout side by side."""
    expert = "the scripted expert (GelSight left, TacTip right)"
    say(f"\n[1/5] recording {config.episodes} demos with {expert}, markers as drawn")
    from uniforce_cli import lerobot_training, record, score, show, view
    from uniforce_cli.sensors_page import SensorFilm, write_sensors_page
    from uniforce_vtla.evaluation.arms import table

    recording = record.RecordConfig(
        episodes=config.episodes,
        level=config.level,
        root=str(out / "demos"),
        left_sensor="gelsight:drawing",  # raw frames take twice as long
        right_sensor="tactip:drawing",
    )
    record.record(recording)
    say("\n[2/5] training view: cameras resized once, touch encoded once by the frozen tokenizer")
    view.make_view(view.ViewConfig(roots=str(out / "demos"), out=str(out / "view")))
    say(f"\n[3/5] training a tiny policy for {config.train_steps} steps with LeRobot's own trainer")
    lerobot_training.train(_train_arguments(config, out))
    sensors = "trained sensor, then two swapped ones, nothing retrained"
    say(f"\n[4/5] rolling out the shipped policy: {sensors}")
    reports = []
    films = []
    for arm, sensor in ARMS.items():
        scoring = score.ScoreConfig(
            arm=arm,
            left_sensor="gelsight",
            right_sensor=sensor,
            level=config.level,
            rollouts=config.rollouts,
            first_seed=FIRST_SCENE,
            videos=1,
            out=str(out / "score"),
        )
        report = score.score(scoring)
        reports.append(report)
        row = report.rows[0]
        clean = sum(row.clean for row in report.rows)
        tally = f"{clean} of {config.rollouts} scenes clean"
        films.append(SensorFilm(SHOWN_AS[sensor], scoring.video(row.seed), row, tally))
    say("\n[5/5] report")
    arms = {report.arm: report.as_dict() for report in reports}
    content = {"level": config.level, "label": "smoke, no claim", "arms": arms}
    write_json(out / "wiping.json", content | provenance())
    shown = show.ShowDatasetConfig(root=str(out / "demos"), out=str(out / "show"))
    show.show_dataset(shown)
    say(table(reports))
    return write_sensors_page(films, out / "sensors.html")


def _train_arguments(config: DemoConfig, out: Path) -> list[str]:
    return [
        "policy=pi05_uniforce",
        "policy.size=tiny",
        "policy.device=cpu",
        "dataset.repo_id=local/demo",
        f"dataset.root={out / 'view'}",
        f"steps={config.train_steps}",
        "batch_size=8",
        "num_workers=0",
        "log_freq=5",
        f"save_freq={config.train_steps}",
        f"output_dir={out / 'train'}",
    ]


def _start_over(out: Path) -> None:
    """Empty an earlier demo's folder; raises ContractError: a folder that holds something else."""
    if out.exists() and any(out.iterdir()) and not (out / MARKER).is_file():
        do = f"Name a new folder, or remove it yourself: it holds no {MARKER}."
        raise ContractError(expected("out", "an empty folder or an earlier demo", str(out), do))
    shutil.rmtree(out, ignore_errors=True)
    write_json(out / MARKER, provenance())


@command(DemoConfig)
def main(config: DemoConfig) -> None:
    logging.basicConfig(level=logging.WARNING)
    os.environ.setdefault("HF_HUB_OFFLINE", "1")
    run(config)
