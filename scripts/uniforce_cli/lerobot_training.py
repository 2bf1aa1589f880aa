"""LeRobot's trainer with checked settings, training views and hashed checkpoints."""

import io
import logging
import sys
from argparse import ArgumentError
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from accelerate import Accelerator
from accelerate.utils import DistributedDataParallelKwargs
from draccus.utils import DraccusException
from lerobot.configs import parser
from lerobot.configs.train import TRAIN_CONFIG_NAME, TrainPipelineConfig
from lerobot.scripts import lerobot_train
from lerobot.utils.constants import PRETRAINED_MODEL_DIR
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_policy_pi05_uniforce import PI05UniforceConfig
from uniforce_cli.boundary import one_thread
from uniforce_cli.compat import training_views
from uniforce_vtla.arguments import Option, check, options_of, read_value, reason_of, split_words
from uniforce_vtla.errors import (
    CheckpointError,
    ContractError,
    DatasetError,
    UniForceError,
    expected,
    nearest,
)
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import VIEW_MARKER
from uniforce_vtla.options import Range, Writable, at_home, check_text, shortened

VERIFY = "verify="
EPISODES = "dataset.episodes"
CHOICES = ("policy", "env")  # LeRobot wants --policy.type=NAME
OURS = "pi05_uniforce"
DEFAULTS = {"policy.push_to_hub": "false", "wandb.enable": "false"}
# loading takes 3 % of a step, and workers would take the cores that train; checkpoints are small
ON_CPU = {"num_workers": "0", "save_freq": "1000"}
RANGES = {  # of LeRobot's own settings, which it does not check
    "steps": Range(1, 10_000_000),
    "batch_size": Range(1, 65_536),
    "num_workers": Range(0, 256),
    "prefetch_factor": Range(1, 1024),
    "log_freq": Range(0, 10_000_000),
    "seed": Range(0, 2**32 - 1),
}
ARGUMENTS = (ArgumentError, ValueError, TypeError, KeyError, AttributeError, NotImplementedError)
LEROBOTS_ERRORS = (OSError, *ARGUMENTS)  # what its parser and its checks raise over a setting
KEPT_GROUPS: list[Any] = []  # process groups of trainings that ended, see ``TrainingAccelerator``
# LeRobot's, by the policy's dtype
MIXED_PRECISION = {"bfloat16": "bf16", "float16": "fp16", "float32": "no"}


def to_lerobot(argv: Sequence[str]) -> list[str]:
    """Turn ``policy=NAME k=v`` into ``--policy.type=NAME --k=v`` and add the defaults not given."""
    flags = [_flag(argument) for argument in argv]
    given = {flag[2:].partition("=")[0] for flag in flags if flag.startswith("--")}
    if "--resume=true" in map(str.lower, flags):  # a resumed run brings its own settings
        return flags
    defaults = dict(DEFAULTS)
    on_cpu = "--policy.device=cpu" in flags
    if "policy.device" not in given:
        on_cpu = not torch.accelerator.is_available()  # then LeRobot takes the CPU
    if on_cpu:
        defaults |= ON_CPU
    return flags + [f"--{key}={value}" for key, value in defaults.items() if key not in given]


def _flag(argument: str) -> str:
    if argument.startswith("-") or "=" not in argument:
        return argument
    key, _, value = argument.partition("=")
    if key in CHOICES:
        key += ".type"
    return f"--{key}={value}"


def take_verify(argv: Sequence[str]) -> tuple[str, list[str]]:
    """Return the last ``verify=…`` or "", which LeRobot doesn't know, and the other arguments."""
    verify = ""
    others = []
    for argument in argv:
        if argument.removeprefix("--").startswith(VERIFY):
            verify = argument.removeprefix("--").removeprefix(VERIFY)
        else:
            others.append(argument)
    return verify, others


class TrainingAccelerator(Accelerator):
    """LeRobot's accelerator for our policy, but for two things.

    It skips the search for unused parameters, a walk over the graph in every step: ours has none
    (``training.py``, and a test per training option).

    It lets the process group live as long as the process. LeRobot's trainer drops the group with
    its last frame, microseconds after a barrier. The thread that drops it holds Python's lock and
    waits for gloo's thread. That may still be releasing the barrier's tensors, for which it wants
    the lock: a deadlock inside PyTorch (``~Reducer`` → ``~ProcessGroupGloo`` → ``join``), seen
    once.
    """

    def __init__(self, config: PI05UniforceConfig) -> None:
        super().__init__(
            step_scheduler_with_optimizer=False,
            mixed_precision=MIXED_PRECISION[config.dtype],
            kwargs_handlers=[DistributedDataParallelKwargs(find_unused_parameters=False)],
            cpu=config.device == "cpu",
        )

    def end_training(self) -> None:
        """Keep the group's last reference, then end as usual."""
        if torch.distributed.is_initialized():
            KEPT_GROUPS.append(torch.distributed.group.WORLD)
        super().end_training()


def trains_ours(flags: Sequence[str]) -> bool:
    """Return whether these flags name a pi05_uniforce, by type or by a checkpoint's folder."""
    given = dict(flag[2:].split("=", 1) for flag in flags if flag.startswith("--") and "=" in flag)
    started = Path(given.get("policy.path", "")) / "config.json"
    resumed = Path(given.get("config_path", "")).parent / "config.json"
    for key, config in (("policy.path", started), ("config_path", resumed)):
        if key in given and config.is_file():
            return read_object(config, CheckpointError).get("type") == OURS
    return given.get("policy.type") == OURS


def read_settings(flags: Sequence[str]) -> TrainPipelineConfig:
    """Return LeRobot's settings as its parser reads them from ``sys.argv``, after checking them.

    Raises ContractError: a setting LeRobot doesn't have, of a wrong type or out of range, a path
    that can't be used.
    """
    said = io.StringIO()
    disabled = logging.root.manager.disable
    # what LeRobot warns of here, it does again when the work begins
    logging.disable(logging.WARNING)
    try:
        _check(split_words(flags), trains_ours(flags))
        with redirect_stderr(said):
            settings: TrainPipelineConfig = parser.wrap()(_settings)()
        settings.validate()
    except UniForceError as error:
        raise _with_nearest(error) from error
    except SystemExit as error:  # LeRobot's way to end after a wrong type; it printed why
        raise ContractError(f"settings: {_said(said.getvalue())} See --help.") from error
    except FileExistsError as error:
        do = "Name another or remove it; a checkpoint in it goes on with resume=true config_path=…."
        came = shortened(str(error), 200)
        raise ContractError(
            expected("output_dir", "a folder that isn't there yet", came, do)
        ) from error
    except (*LEROBOTS_ERRORS, DraccusException) as error:
        reason: BaseException = error
        if isinstance(error, DraccusException):
            reason = reason_of(error)
        raise ContractError(
            expected("settings", "what LeRobot takes", _said(reason), "See --help.")
        ) from error
    finally:
        logging.disable(disabled)
    return settings


def _settings(cfg: TrainPipelineConfig) -> TrainPipelineConfig:
    return cfg


def settings_known() -> dict[str, Option]:
    """Return LeRobot's settings and our policy's, with the ranges that we add."""
    known = options_of(TrainPipelineConfig) | options_of(PI05UniforceConfig, "policy.")
    for name, allowed in RANGES.items():
        known[name] = replace(known[name], rule=allowed)
    return known


def _check(given: Mapping[str, str], ours: bool) -> None:
    known = settings_known()
    for name, text in given.items():
        check_text(name, text)
        if name in known and (ours or not name.startswith("policy.")):
            check(known[name], read_value(known[name], text))
    _check_config_path(given)
    _check_resumed(given)
    if "dataset.root" in given:
        root = Path(given["dataset.root"])
        episodes = given.get(EPISODES, "null")
        if not (root / VIEW_MARKER).is_file() and not (root / "meta/info.json").is_file():
            came = given["dataset.root"]
            wanted = "a dataset or a training view"
            do = "Make a view with `uniforce view roots=… out=…`, or check the path."
            raise ContractError(expected("dataset.root", wanted, came, do))
        if episodes != "null":
            _check_episodes(root, read_value(known[EPISODES], episodes))
    if "output_dir" in given:
        Writable().check("output_dir", given["output_dir"])


def _check_episodes(root: Path, chosen: Sequence[int]) -> None:
    """Raise ContractError for episodes that aren't there, none at all, or one that comes twice."""
    from uniforce_datasets.view_plan import read_marker

    if (root / VIEW_MARKER).is_file():
        stored = len(read_marker(root)["episodes"])
    else:
        info = read_object(root / "meta" / "info.json", DatasetError)
        stored = int(info.get("total_episodes") or 0)
    if not chosen or len({*chosen}) < len(chosen) or not {*chosen} <= {*range(stored)}:
        wanted = f"numbers from 0 to {stored - 1}, each once"
        raise ContractError(expected(EPISODES, wanted, chosen, "Leave it out to take all."))


def _check_config_path(given: Mapping[str, str]) -> None:
    """Raise ContractError where a run to go on with names no checkpoint's settings.

    A name on the hub is LeRobot's to find. Raises CheckpointError: the settings are damaged.
    """
    named = given.get("config_path", "")
    file = Path(named)
    if file.is_dir():
        file /= TRAIN_CONFIG_NAME
    is_missing = not file.is_file() and (file.suffix == ".json" or file.parent.exists())
    if (is_missing and named) or (not named and given.get("resume", "false").lower() == "true"):
        do = f"Give config_path=…/checkpoints/last/{PRETRAINED_MODEL_DIR}/{TRAIN_CONFIG_NAME}"
        raise ContractError(
            expected("config_path", f"a checkpoint's {TRAIN_CONFIG_NAME}", named or "none", do)
        )
    if file.is_file() and file.suffix == ".json":
        read_object(file, CheckpointError)


def _check_resumed(given: Mapping[str, str]) -> None:
    """Raise ContractError where a run that goes on is told anew what its policy feels."""
    told = [name for name in given if name.startswith("policy.touch.")]
    if told and given.get("resume", "false").lower() == "true":
        wanted = "a resumed run with what its policy feels as the checkpoint says"
        do = "Leave it out, or start a new run without resume."
        raise ContractError(expected(told[0], wanted, given[told[0]], do))


def _with_nearest(error: UniForceError) -> UniForceError:
    """Add the nearest known name to what argparse says of an unknown one."""
    _, unknown, words = str(error).partition("unrecognized arguments: ")
    name = words.partition("=")[0].removeprefix("--")
    do = nearest(name, settings_known(), "", "=…")
    if unknown and do:
        return ContractError(f"{error} {do}")
    return error


def _said(error: object) -> str:
    text = str(error)
    if isinstance(error, Exception):
        text = f"{type(error).__name__}: {text}"
    return shortened(text, 300)


def _at_home(flag: str) -> str:
    name, equals, text = flag.partition("=")
    return name + equals + at_home(text)


def train(argv: Sequence[str]) -> None:
    """Run ``lerobot-train``; UniForceError: settings, data or a checkpoint it can't use."""
    register_third_party_plugins()
    verify, settings = take_verify(argv)
    flags = [_at_home(flag) for flag in to_lerobot(settings)]
    before = sys.argv
    sys.argv = [before[0], *flags]  # LeRobot's parser reads sys.argv itself
    try:
        if "--help" in flags:
            lerobot_train.main()
        config = read_settings(flags)
        ours = isinstance(config.policy, PI05UniforceConfig) and not config.job.is_remote
        if ours and config.policy.size == "tiny" and config.policy.device == "cpu":
            # a second one buys nothing, and beside other programs they wait for each other
            one_thread()
        accelerator = TrainingAccelerator(config.policy) if ours else None
        with training_views(verify):
            # parsed once: another parse would stamp another second into the output's name
            lerobot_train.train(config, accelerator=accelerator)
        if ours:
            policy = f"{config.output_dir}/checkpoints/last/pretrained_model"
            print(f"next: uniforce score policy={policy} rollouts=100")
    finally:
        sys.argv = before
