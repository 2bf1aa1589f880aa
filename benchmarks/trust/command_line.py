"""Bad command lines for every command: each must end at once with one line, code 2 and no published file changed."""

import hashlib
import importlib
import logging
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tqdm import tqdm

from benchmarks.ledger import update
from benchmarks.trust.bad_words import BadInput, Room, bad_inputs
from benchmarks.trust.command_worker import CommandWorker, Ended, import_once
from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint
from uniforce_cli.boundary import REFUSED, guarded
from uniforce_cli.main import VERBS
from uniforce_vtla.arguments import Option, options_of, parse, split_words
from uniforce_vtla.options import Existing, Names, OutFile, Positive, Workers, split

ROOT = Path(__file__).parents[2]
PUBLISHED = Path("docs/results")
BENCHMARKS = sorted(  # whatever declares its options to the boundary
    file.parent.name if file.stem == "__main__" else file.stem
    for pattern in ("*.py", "*/__main__.py")
    for file in (ROOT / "benchmarks").glob(pattern)
    if "@command(" in file.read_text()
)
MODULES = {verb: f"uniforce_cli.{verb}" for verb in VERBS} | {
    name: f"benchmarks.{name}{'.__main__' * (ROOT / 'benchmarks' / name).is_dir()}"
    for name in BENCHMARKS
}
COMMANDS = {name: f"{module}:main" for name, module in MODULES.items()}
Commands = Annotated[str, Names(tuple(COMMANDS), many=True)]
SOUND = {  # what a command needs besides sound folders, to begin its work
    "verify": ("root={room}/dataset",),
    "share": ("checkpoint={shipped}",),
    "touch": ("source=standin",),
    "estimate": ("pad_friction=0.6,0.7",),
    "calibrate": ("grasps=60",),
    "convert": ("view={room}/view",),
    "real": ("data={room}/dataset",),
}
ROBOT = ("robot=franka", "teleop=keyboard", "prompts=[wipe]")
CONTROL_S = 12.0  # the sound words alone: a command that refuses those refuses anything
VERDICTS = ("one_line", "tracebacks", "silent", "long_or_beside_the_point")


@dataclass
class CommandLineConfig:
    """Try every command with bad inputs made from its options; write the counts.

    Example: python -m benchmarks.trust.command_line only=score,train out=docs/results/trust.json
    """

    only: Commands = ""  # commands, comma between them; empty = all
    limit_s: Positive = 30.0  # a command still at work then has accepted the input
    workers: Workers = 2  # commands at once
    out: OutFile = "outputs/trust.json"  # the result file; only its key ``command_line`` changes


@dataclass(frozen=True)
class Trial:
    """A command line that must be refused: sound words that would do, with the bad ones in their place."""

    command: str
    bad: BadInput
    sound: tuple[str, ...]

    @property
    def words(self) -> tuple[str, ...]:
        given = {word.removeprefix("--").partition("=")[0] for word in self.bad.words}
        return (*(w for w in self.sound if w.partition("=")[0] not in given), *self.bad.words)


def trials(command: str, room: Room) -> list[Trial]:
    if command == "train":
        return _train_trials(room)
    options = options_of(entry(command).config_class)
    named = tuple(
        w.format(room=room.folder, shipped=shipped_checkpoint()) for w in SOUND.get(command, ())
    )
    given = {word.partition("=")[0] for word in named}
    sound = (
        *named,
        *(word for word in _sound(options, room) if word.partition("=")[0] not in given),
    )
    found = [Trial(command, bad, sound) for bad in bad_inputs(options, room)]
    return found + (_robot_trials(room) if command == "record" else [])


def entry(command: str) -> Any:
    """Return the function behind a command."""
    module, function = COMMANDS[command].split(":")
    return getattr(importlib.import_module(module), function)


def _sound(options: Mapping[str, Option], room: Room) -> tuple[str, ...]:
    """Return words that name something whole for every input that must be there."""
    found = []
    for option in options.values():
        rule = option.rule
        if isinstance(rule, Existing) and option.default not in ("", *rule.words, str(PUBLISHED)):
            found.append(f"{option.name}={room.sound(rule.marker, str(shipped_checkpoint()))}")
    return tuple(found)


def _train_trials(room: Room) -> list[Trial]:
    """Return bad inputs for a sample of LeRobot's and the policy's settings."""
    from uniforce_cli.lerobot_training import RANGES, settings_known

    known = settings_known()
    rest = [name for name in known if name not in RANGES and not name.startswith("job.")]
    options = {name: known[name] for name in (*RANGES, *rest[::3])}
    paths = {"dataset.root": "nothing", "policy.path": "nothing"}
    paths |= {"config_path": "nothing/train_config.json", "output_dir": "/proc/nothing/run"}
    data = ("dataset.repo_id=local/view", f"dataset.root={room.folder / 'view'}", "num_workers=0")
    sound = (
        "policy=pi05_uniforce",
        "policy.size=tiny",
        "policy.device=cpu",
        *data,
        "output_dir=run",
    )
    named = [BadInput("path", (f"{name}={text}",), name) for name, text in paths.items()]
    return [Trial("train", bad, sound) for bad in (*bad_inputs(options, room), *named)]


def _robot_trials(room: Room) -> list[Trial]:
    """Return bad inputs for the settings of the robot and of what steers it, read by LeRobot's parser."""
    from uniforce_robots.franka.config import UniforceFrankaConfig
    from uniforce_robots.teleop import UniforceKeyboardConfig

    robot, teleop = (
        options_of(UniforceFrankaConfig, "robot."),
        options_of(UniforceKeyboardConfig, "teleop."),
    )
    return [
        Trial("record", bad, ROBOT)
        for options in (robot, teleop)
        for bad in bad_inputs(options, room)
    ]


def judge(trial: Trial, ended: Ended) -> str:
    if "Traceback" in ended.said or ended.code == 70:
        return "tracebacks"
    if ended.code != REFUSED:
        return "silent"
    lines = [line for line in ended.said.splitlines() if line.strip()]
    return (
        "one_line"
        if len(lines) == 1 and trial.bad.is_named_in(lines[0])
        else "long_or_beside_the_point"
    )


def try_command(
    command: str, room: Room, folder: Path, limit_s: float, most: int | None = None
) -> dict[str, Any]:
    """Run a command's trials (``most`` of them, spread over all); return counts and every failure."""
    every = trials(command, room)
    chosen = every if most is None else every[:: max(1, len(every) // most)][:most]
    worker, failures, counts = CommandWorker(COMMANDS[command], folder), [], Counter[str]()
    try:
        control = {
            sound: worker.run(sound, CONTROL_S)
            for sound in sorted({trial.sound for trial in chosen})
        }
        for trial in tqdm(chosen, desc=command, leave=False):
            ended = worker.run(trial.words, limit_s)
            verdict = judge(trial, ended)
            counts[verdict] += 1
            if verdict != "one_line":
                words = " ".join(word[:120] for word in trial.words)
                said = f"{verdict}: {command} {words} -> {ended.code}: {ended.said[-300:]}"
                failures.append(_portable(said, room))
                tqdm.write(failures[-1])
    finally:
        worker.close()
    counted = {"inputs": len(chosen), **{verdict: counts[verdict] for verdict in VERDICTS}}
    sound = {
        _portable(" ".join(words), room): _portable(
            "at work" if ended.code is None else f"{ended.code}: {ended.said[-300:]}", room
        )
        for words, ended in control.items()
    }
    return counted | {"failures": failures, "sound_words": sound}


def _portable(text: str, room: Room) -> str:
    """Return a text without this machine's folders, for a published file."""
    return text.replace(str(room.folder), "ROOM").replace(str(ROOT), "ROOT")


def hashes(folder: Path) -> dict[str, str]:
    return {
        str(f): hashlib.sha256(f.read_bytes()).hexdigest()
        for f in sorted(folder.rglob("*"))
        if f.is_file()
    }


def prepare(folder: Path) -> Room:
    """Make what commands are tried with; the working folder gets published files of its own, to be left alone."""
    shutil.copytree(ROOT / PUBLISHED, folder / "work" / PUBLISHED)
    (folder / "room").mkdir()
    return Room(folder / "room").build()


def attack(config: CommandLineConfig) -> dict[str, Any]:
    chosen = split(config.only) or list(COMMANDS)
    import_once([MODULES[name] for name in chosen])
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(config.workers) as pool:
        folder = Path(scratch)
        room, places = prepare(folder), (ROOT / PUBLISHED, folder / "work" / PUBLISHED)
        before = [hashes(place) for place in places]
        tried = pool.map(
            lambda name: try_command(name, room, folder / "work", config.limit_s), chosen
        )
        rows = dict(zip(chosen, tried, strict=True))
        after = [hashes(place) for place in places]
    touched = sum(len(set(a.items()) ^ set(b.items())) for a, b in zip(before, after, strict=True))
    totals = {key: sum(row[key] for row in rows.values()) for key in ("inputs", *VERDICTS)}
    return totals | {"published_touched": touched, "rows": rows}


def main(argv: list[str] | None = None) -> int:
    """Run the attack, write the table, print it; 1 where anything but one line came."""
    split_words(argv or sys.argv[1:])
    config = parse(CommandLineConfig, argv)
    logging.disable(logging.CRITICAL)
    table = attack(config)
    path = update(Path(config.out), "command_line", table)
    for name, row in table["rows"].items():
        print(f"{name:20s} " + "  ".join(f"{key} {row[key]}" for key in ("inputs", *VERDICTS)))
    print(
        f"{table['one_line']} of {table['inputs']} in one line; {table['published_touched']} published files touched"
    )
    print(f"written to {path}")
    return int(table["one_line"] < table["inputs"] or table["published_touched"] > 0)


if __name__ == "__main__":
    sys.exit(guarded("command_line", main))
