"""Where a command ends: whatever it raises becomes one line and an exit code; ``--debug`` shows where it came from."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import NoReturn

import yaml
from draccus.utils import DraccusException

from uniforce_vtla.errors import ContractError, UniForceError, without_credentials
from uniforce_vtla.options import shortened

REFUSED, FAULT, STOPPED = 2, 70, 130
DEBUG = "--debug"
Main = Callable[[Sequence[str]], int]
LONGEST_LINE = 600


def command(main: Main) -> Callable[[Sequence[str] | None], int]:
    """Return ``main`` as an entry point: arguments are the process's own when None, errors one line each.

    Exit codes: the command's own; 2 for what a user can put right, 130 after Ctrl-C, 70 for a fault of the program.
    """
    name = "uniforce-" + main.__module__.rpartition(".")[2].replace("_", "-")

    @wraps(main)
    def guarded(argv: Sequence[str] | None = None) -> int:
        words = list(sys.argv[1:] if argv is None else argv)
        if DEBUG in words:
            return main([word for word in words if word != DEBUG])
        try:
            with usage_as_error():
                return main(words)
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

    return guarded


def _end(name: str, text: str, code: int) -> int:
    print(f"{name}: {without_credentials(shortened(text, LONGEST_LINE))}", file=sys.stderr)
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
