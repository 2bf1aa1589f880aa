"""Bad command lines for every verb and benchmark: each must end in one line with code 2."""

import hashlib
import importlib
import shutil
from dataclasses import dataclass
from pathlib import Path

from bad_words import BadInput, Room, bad_inputs

from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint
from uniforce_cli.main import VERBS
from uniforce_vtla.arguments import options_of
from uniforce_vtla.options import Existing

ROOT = Path(__file__).parents[1]
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
SOUND = {  # what a command needs besides sound folders, to begin its work
    "verify": "root={room}/dataset",
    "share": "checkpoint={shipped}",
    "touch": "source=standin",
    "estimate": "pad_friction=0.6,0.7",
    "calibrate": "grasps=60",
    "convert": "view={room}/view",
    "real": "data={room}/dataset",
}
ROBOT = {"robot": "franka", "teleop": "keyboard", "prompts": "[wipe]"}


@dataclass(frozen=True)
class Trial:
    """A command line that must be refused: sound words that would do, with bad ones in place."""

    bad: BadInput
    sound: dict[str, object]

    @property
    def words(self):
        given = {word.removeprefix("--").partition("=")[0] for word in self.bad.words}
        sound = [f"{name}={text}" for name, text in self.sound.items() if name not in given]
        return [*sound, *self.bad.words]


def trials(command, room):
    if command == "train":
        return _train_trials(room)
    options = options_of(entry(command).config_class)
    sound = _sound(options, room)
    named = SOUND.get(command, "").format(room=room.folder, shipped=shipped_checkpoint())
    sound |= dict(word.split("=") for word in named.split())
    found = [Trial(bad, sound) for bad in bad_inputs(options, room)]
    if command == "record":
        found += _robot_trials(room)
    return found


def entry(command):
    """Return the function behind a command."""
    return importlib.import_module(MODULES[command]).main


def exit_code(main, words):
    """Run a command on words."""
    try:
        return int(main(words) or 0)
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else 1


def _sound(options, room):
    """Return option → something whole for every input that must be there."""
    found = {}
    for option in options.values():
        rule = option.rule
        if isinstance(rule, Existing) and option.default not in ("", *rule.words, str(PUBLISHED)):
            found[option.name] = room.sound(rule.marker)
    return found


def _train_trials(room):
    """Return bad inputs for a sample of LeRobot's and the policy's settings."""
    from uniforce_cli.lerobot_training import RANGES, settings_known

    known = settings_known()
    rest = [name for name in known if name not in RANGES and not name.startswith("job.")]
    options = {name: known[name] for name in (*RANGES, *rest[::3])}
    paths = {
        "dataset.root": "nothing",
        "policy.path": "nothing",
        "config_path": "nothing/train_config.json",
        "output_dir": "/proc/nothing/run",
    }
    sound = {
        "policy": "pi05_uniforce",
        "policy.size": "tiny",
        "policy.device": "cpu",
        "dataset.repo_id": "local/view",
        "dataset.root": room.folder / "view",
        "num_workers": 0,
        "output_dir": "run",
    }
    bad = [BadInput("path", (f"{name}={text}",), name) for name, text in paths.items()]
    return [Trial(one, sound) for one in (*bad_inputs(options, room), *bad)]


def _robot_trials(room):
    """Return bad inputs for the settings of the robot and of what steers it."""
    from uniforce_robots.franka.config import UniforceFrankaConfig
    from uniforce_robots.teleop import UniforceKeyboardConfig

    found = []
    for config, prefix in ((UniforceFrankaConfig, "robot."), (UniforceKeyboardConfig, "teleop.")):
        for bad in bad_inputs(options_of(config, prefix), room):
            found.append(Trial(bad, ROBOT))
    return found


def hashes(folder):
    files = [file for file in sorted(folder.rglob("*")) if file.is_file()]
    return {str(file): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def prepare(folder):
    """Make what commands are tried with; the working folder gets published files of its own."""
    shutil.copytree(ROOT / PUBLISHED, folder / "work" / PUBLISHED)
    (folder / "room").mkdir()
    return Room(folder / "room").build()
