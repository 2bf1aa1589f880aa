"""End of every command: an error becomes one line and an exit code; ``--debug`` shows its source.

Also the types of options that several commands share; their rules are in
``uniforce_vtla/options.py``.
"""

import argparse
import json
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import yaml
from draccus.utils import DraccusException

from uniforce_vtla.arguments import parse, reason_of, split_words
from uniforce_vtla.errors import (
    ContractError,
    UniForceError,
    expected,
    no_room,
    without_credentials,
)
from uniforce_vtla.options import Existing, Names, Pattern, split
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.terminal import LastingText, stops_like_ctrl_c

# exit codes
REFUSED = 2
NO_ROOM = 4
FAULT = 70
STOPPED = 130
DEBUG = "--debug"
OURS = (
    "uniforce_",
    "lerobot_policy_pi05_uniforce",
    "lerobot_env_uniforce",
    "benchmarks",
)  # packages; a fault is ours there
LESS_MEMORY = "Close other programs, or take fewer workers or a smaller batch_size"
LONGEST_LINE = 600
GROWN_bytes = 4_000_000_000  # a process of rollouts may grow by

# how files are checked: whole, sizes and samples, not at all
Verify = Literal["full", "quick", "off"]
# the environment's, which takes seconds to import; a test compares
Level = Literal["easy", "touch"]
Gripper = Literal["servo", "hand"]  # of the scene
Sensor = Annotated[str, Names(list_sensors())]
# words for the sensor on a simulated finger (uniforce_vtla/contact/worn_in_words.py)
_WORN = r"\w+(:(any|drawing|\d{1,6}))?(\+\w+=[\d.]+)*"
Worn = Annotated[str, Pattern("a sensor and which unit of it", _WORN, "tactip:any")]
Head = Annotated[str, Existing("a force head's folder", "config.json", words=list_sensors())]
Sensors = Annotated[str, Names(list_sensors(), many=True)]


class Command:
    """An entry point that knows its options: a command line in, one line for an error.

    Exit codes: the command's own; 2 for what a user can put right, 4 for a full disk, 70 for a
    fault of the program, 130 after Ctrl-C, kill or a closed terminal.

    Args:
        main: gets the config; returns an exit code, None for 0.
        config_class: the options are parsed into it; None = ``main`` gets the words themselves.
        presets: see ``parse``.
        others: options that begin like this are not parsed; ``main`` gets them, as
            ``--key=value``, beside the config, and the names of the options that were given.
    """

    def __init__(
        self,
        main: Callable[..., int | None],
        config_class: type | None,
        presets: Path | None = None,
        others: tuple[str, ...] = (),
    ) -> None:
        self._main = main
        self.config_class = config_class
        self._presets = presets
        self.others = others
        module = main.__module__  # a person typed uniforce record, or benchmarks.gates
        verb = module.removeprefix("uniforce_cli.")
        self._name = module if verb == module else f"uniforce {verb}"

    def __call__(self, argv: Sequence[str] | None = None) -> int:
        """Run on the given arguments, the process's own when None; return the exit code."""
        if argv is None:
            argv = sys.argv[1:]
        run = partial(self._run, [word for word in argv if word != DEBUG])
        with stops_like_ctrl_c():
            if DEBUG in argv:
                return run()
            with _warnings_in_one_line():
                return guarded(self._name, run)

    def _run(self, words: list[str]) -> int:
        if self.config_class is None:
            return self._main(words) or 0
        own = []
        flags = []
        for word in words:
            name = word.removeprefix("--")
            if name.startswith(self.others):
                flags.append(f"--{name}")
            else:
                own.append(word)
        split_words(flags)
        config: Any = parse(self.config_class, own, self._presets)
        if self.others:
            return self._main(config, flags, list(split_words(own))) or 0
        return self._main(config) or 0


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Print warnings without the file and line that they come from."""
    usual = warnings.formatwarning
    warnings.formatwarning = lambda message, *_, **__: f"warning: {message}\n"
    try:
        yield
    finally:
        warnings.formatwarning = usual


def command(
    config_class: type | None, presets: Path | None = None, others: tuple[str, ...] = ()
) -> Callable[[Callable[..., int | None]], Command]:
    """Make ``main(config)`` a ``Command``, which says what the arguments are."""
    return lambda main: Command(main, config_class, presets, others)


def by_name(text: str) -> dict[str, str]:
    """Return the pairs of an option like ``touch0:right,touch1:left``."""
    return dict(pair.split(":", 1) for pair in split(text))


def refuse_ignored(mode: str, ignored: Sequence[str]) -> None:
    """Raise ContractError where settings were given that change nothing in this mode."""
    if ignored:
        came = ", ".join(ignored)
        do = "Leave them out."
        raise ContractError(expected(f"settings with {mode}", "those it uses", came, do))


def changed(config: Any, names: Sequence[str]) -> list[str]:
    """Return which of these settings differ from their defaults."""
    usual = type(config)()
    return [name for name in names if getattr(config, name) != getattr(usual, name)]


def refuse_unused(config: Any, mode: str, names: Sequence[str]) -> None:
    """Raise ContractError where one of these settings, without effect in this mode, was changed."""
    refuse_ignored(mode, changed(config, names))


def one_thread() -> None:
    """Let torch, OpenCV and numpy compute on one thread: small work gains nothing from more."""
    import cv2
    import torch
    from threadpoolctl import threadpool_limits

    threadpool_limits(1, user_api="blas")
    torch.set_num_threads(1)
    cv2.setNumThreads(1)


def worker_process() -> None:
    """Compute on one thread, and keep this process with its checkpoints and rigs, 35 MB each.

    joblib replaces a process that grew by .3 GB; importing and building then begin again. It has no
    public setting.
    """
    from joblib.externals.loky import process_executor

    one_thread()
    process_executor._MAX_MEMORY_LEAK_SIZE = GROWN_bytes


def guarded(name: str, run: Callable[[], int]) -> int:
    """Return what ``run`` returns; say in one line what it raises, and return 2, 4, 70 or 130."""
    try:
        with usage_as_error():
            return run()
    except KeyboardInterrupt:
        return _end(name, "stopped", STOPPED)
    except DraccusException as error:
        text = expected("settings", "what it takes", reason_of(error), "See --help.")
        return _end(name, text, REFUSED)
    except (UniForceError, yaml.YAMLError, json.JSONDecodeError) as error:
        return _end(name, str(error), NO_ROOM if no_room(error) else REFUSED)
    except Exception as error:
        surroundings = _surroundings(error)
        if surroundings:
            return _end(name, surroundings, NO_ROOM if no_room(error) else REFUSED)
        fault = f"a fault of this program, {type(error).__name__}: {error}"
        return _end(name, f"{fault}. Run it with {DEBUG} and report it.", FAULT)


def _surroundings(error: Exception) -> str:
    """Return a line about files, disks, memory, network or packages; "" for another error."""
    if "huggingface_hub" in sys.modules:
        said = _said_by_hub(error)
        if said:
            return said
    match error:
        case OSError(filename=str() | bytes() | Path() as path):
            return f"{path!s}: {error.strerror}. Check the path and the room on its disk."
        case OSError() if no_room(error):
            return f"disk: {error.strerror}. Check the path and the room on its disk."
        case OSError():
            return f"{error}. Check files, devices and the network."
        case UnicodeDecodeError():
            return expected("text files", "UTF-8", error, "Save them as UTF-8.")
        case BrokenExecutor():
            wanted = "a worker process that lives to its end"
            return expected("workers", wanted, "one that was killed", f"{LESS_MEMORY}.")
        case Exception() if _out_of_memory(error):
            return expected("memory", "enough of it", error, f"{LESS_MEMORY}.")
        case ImportError() if not str(error.name).startswith(OURS):
            return f"{error}. Install it; README.md names what is optional."
        case Exception() if type(error).__module__.startswith("wandb."):
            said = str(error).rstrip(".")
            return expected("wandb", "a login", said, "wandb.enable=false does without.")
    return ""


def _out_of_memory(error: Exception) -> bool:
    """Return whether Python, or torch on a CPU or an accelerator, found no memory."""
    # torch has an error of its own for accelerators alone
    is_torchs = type(error).__name__ == "OutOfMemoryError" or "DefaultCPUAllocator" in str(error)
    return isinstance(error, MemoryError) or is_torchs


def _said_by_hub(error: Exception) -> str:
    """Return a line about an answer of the Hugging Face hub, or none; "" for another error."""
    import httpx
    from huggingface_hub import errors

    match error:
        case errors.OfflineModeIsEnabled():
            return expected("hub", "a connection", "HF_HUB_OFFLINE", "Unset this variable.")
        case errors.HfHubHTTPError(response=httpx.Response(status_code=401 | 403 as code)):
            do = "Log in with `hf auth login`, as one who may write there."
            return expected("hub", "a login", f"answer {code}", do)
        case httpx.TransportError():
            return expected("hub", "a connection", error, "Is the network there? Try again.")
        case errors.HfHubHTTPError() | errors.EntryNotFoundError() | errors.HFValidationError():
            said = str(error).rstrip(".")
            do = "Check the name and your login."
            return expected("hub", "what was asked for", said, do)
    return ""


def _end(name: str, text: str, code: int) -> int:
    line = without_credentials(" ".join(text.split()))
    if len(line) > LONGEST_LINE:  # what to do stands at the end
        line = f"{line[: LONGEST_LINE // 2]} … {line[-LONGEST_LINE // 2 :]}"
    print(f"{name}: {line}", file=LastingText(sys.stderr))
    return code


@contextmanager
def usage_as_error() -> Iterator[None]:
    """Let LeRobot's parser raise an error instead of printing a hundred lines of usage."""
    stock = argparse.ArgumentParser.error

    def error(parser: argparse.ArgumentParser, message: str) -> NoReturn:
        raise ContractError(f"arguments: {message}. See --help.")

    argparse.ArgumentParser.error = error  # type: ignore[method-assign,assignment]
    try:
        yield
    finally:
        argparse.ArgumentParser.error = stock  # type: ignore[method-assign]
