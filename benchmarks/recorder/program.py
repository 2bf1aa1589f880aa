"""``uniforce record`` as a program that starts at once: imported here, forked for every session.

A line in is ``{"argv": […], "tty": PATH}``, lines out are ``ready``, ``pid N`` and ``exit N``. A
session runs on that terminal as its own leader, so that Ctrl-C reaches it as it would a person's;
it is the command itself, with one more teleoperator registered.
"""

import importlib
import json
import logging
import os
import sys
import warnings
from pathlib import Path

from uniforce_vtla.errors import ContractError, expected

LOADED = (
    "benchmarks.recorder.circle",  # registers its teleoperator
    "uniforce_robots.recorder.assemble",
    "uniforce_robots.recorder.build",
    "uniforce_robots.recorder.robot_rig",
    "uniforce_cli.record",
)
# pyarrow's allocator starts it at import and itself looks after forks
ARROWS_THREAD = "jemalloc_bg_thd"


def main() -> int:
    """Fork a session for each order until the orders end; in a session, return its exit code."""
    said = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what imports print is no answer
    _import_all()
    print("ready", os.getpid(), file=said)
    for line in sys.stdin:
        order = json.loads(line)
        with warnings.catch_warnings():
            # the one other thread has been looked at
            warnings.simplefilter("ignore", DeprecationWarning)
            pid = os.fork()
        if not pid:
            return record_on(order["tty"], order["argv"])
        print("pid", pid, file=said)
        print("exit", os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), file=said)
    return 0


def _import_all() -> None:
    """Load what every session loads; no thread may run when it is forked."""
    for module in LOADED:
        importlib.import_module(module)
    names = [(task / "comm").read_text().strip() for task in Path("/proc/self/task").iterdir()]
    own = [name for name in names[1:] if name != ARROWS_THREAD]
    if own:
        do = "Set OMP_NUM_THREADS and OPENBLAS_NUM_THREADS to 1."
        raise ContractError(expected("program to fork", "one thread", f"others: {own}", do))


def record_on(tty: str, argv: list[str]) -> int:
    from uniforce_cli.record import main as record

    os.setsid()
    # a session leader's first one becomes its controlling terminal
    terminal = os.open(tty, os.O_RDWR)
    for standard in (0, 1, 2):
        os.dup2(terminal, standard)
    os.closerange(3, 1024)  # the answers' pipe too: a killed session must leave no one listening
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    form = "%(levelname)s %(name)s: %(message)s"
    # over what imports set up
    logging.basicConfig(level=logging.INFO, stream=sys.stdout, format=form, force=True)
    return record(argv)


if __name__ == "__main__":
    sys.exit(main())
