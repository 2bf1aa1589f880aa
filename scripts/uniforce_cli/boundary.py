"""Where a command ends: whatever it raises becomes one line and an exit code; ``--debug`` shows where it came from."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial, wraps
from pathlib import Path
from typing import Any, NoReturn, Protocol, cast

import yaml
from draccus.utils import DraccusException

from uniforce_vtla.arguments import parse, split_words
from uniforce_vtla.errors import ContractError, UniForceError, without_credentials

REFUSED, FAULT, STOPPED = 2, 70, 130
DEBUG = "--debug"
LONGEST_LINE = 600


class Command(Protocol):
    """An entry point that knows its options."""

    config_class: type | None
    others: tuple[str, ...]

    def __call__(self, argv: Sequence[str] | None = None) -> int:
        """Run on the given arguments, the process's own when None; return the exit code."""


def command(
    config_class: type | None, presets: Path | None = None, others: tuple[str, ...] = ()
) -> Callable[[Callable[..., int]], Command]:
    """Make ``main(config)`` an entry point: a command line in, one line for an error.

    Exit codes: the command's own; 2 for what a user can put right, 130 after Ctrl-C, 70 for a fault of the program.

    Args:
        config_class: what the options are parsed into; None = ``main`` gets the words themselves.
        presets: see ``parse``.
        others: options that begin like this are not parsed; ``main`` gets them, as ``--key=value``, beside the config,
            and the names of the options that were given.
    """

    def decorate(main: Callable[..., int]) -> Command:
        @wraps(main)
        def entry(argv: Sequence[str] | None = None) -> int:
            words = list(sys.argv[1:] if argv is None else argv)
            plain = [word for word in words if word != DEBUG]
            run = partial(_run, main, plain, config_class, presets, others)
            return run() if len(plain) < len(words) else guarded(_name(main), run)

        found = cast("Command", entry)
        found.config_class, found.others = config_class, others
        return found

    return decorate


def _name(main: Callable[..., int]) -> str:
    """Return what a person typed: ``uniforce record``, or ``benchmarks.blind``."""
    module = main.__module__
    return f"uniforce {module.rpartition('.')[2]}" if module.startswith("uniforce_cli.") else module


def _run(
    main: Callable[..., int],
    words: list[str],
    config_class: type | None,
    presets: Path | None,
    others: tuple[str, ...],
) -> int:
    if config_class is None:
        return main(words)
    flags = (
        [f"--{w.removeprefix('--')}" for w in words if w.removeprefix("--").startswith(others)]
        if others
        else []
    )
    own = [word for word in words if not others or not word.removeprefix("--").startswith(others)]
    split_words(flags)
    config: Any = parse(config_class, own, presets)
    return main(config, flags, list(split_words(own))) if others else main(config)


def guarded(name: str, run: Callable[[], int]) -> int:
    """Return what ``run`` returns; say in one line what it raises, and return 2, 70 or 130."""
    try:
        with usage_as_error():
            return run()
    except KeyboardInterrupt:
        return _end(name, "stopped", STOPPED)
    except (UniForceError, DraccusException, yaml.YAMLError, json.JSONDecodeError) as error:
        return _end(name, str(error), REFUSED)
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            do = "Check the path and the room on its disk."
            return _end(name, f"{error.filename}: {error.strerror}. {do}", REFUSED)
        what = f"a fault of this program, {type(error).__name__}: {error}. Run it with {DEBUG} and report it."
        return _end(name, what, FAULT)


def _end(name: str, text: str, code: int) -> int:
    line = without_credentials(" ".join(text.split()))
    if len(line) > LONGEST_LINE:  # what to do stands at the end
        line = f"{line[: LONGEST_LINE // 2]} … {line[-LONGEST_LINE // 2 :]}"
    print(f"{name}: {line}", file=sys.stderr)
    return code


@contextmanager
def usage_as_error() -> Iterator[None]:
    """Let LeRobot's parser raise what is wrong instead of printing its usage, some hundred lines."""
    stock = argparse.ArgumentParser.error

    def error(parser: argparse.ArgumentParser, message: str) -> NoReturn:
        raise ContractError(f"arguments: {message}. See --help.")

    argparse.ArgumentParser.error = error  # type: ignore[method-assign,assignment]
    try:
        yield
    finally:
        argparse.ArgumentParser.error = stock  # type: ignore[method-assign]
