"""The contract of both backends against the stand-in, few cases to a process (see ``backends.py``)."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from uniforce_robots.franka.backends import EXTRAS, fault_of, load_client
from uniforce_vtla.errors import RobotError

PROGRAM = Path(__file__).with_name("backends.py")
# Starting a client costs 4 s, so those cases share a process after which the connection is whole.
CASES = ["life", "bound,reflex,user_stop,stream", "hand,robot", "death", "version", "mute"]


def need(backend: str) -> None:
    if importlib.util.find_spec(backend) is None:
        pytest.skip(f"{backend} is not installed: pip install '.[{EXTRAS[backend]}]' to run the real client")


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize("cases", CASES)
@pytest.mark.parametrize("backend", EXTRAS)
def test_contract(backend: str, cases: str, address: str, tmp_path: Path) -> None:
    need(backend)
    command = [sys.executable, str(PROGRAM), backend, cases, address, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=390)
    assert done.returncode == 0 and done.stdout.endswith("passed\n"), (
        f"exit {done.returncode}\n{done.stderr[-4000:]}"
    )


@pytest.mark.slow
@pytest.mark.parametrize("first, second", [("franky", "pylibfranka"), ("pylibfranka", "franky")])
def test_both_in_one_process_are_refused_before_they_break(first: str, second: str) -> None:
    need(first)
    need(second)
    program = (
        "from uniforce_robots.franka.backends import load_client\n"
        "from uniforce_vtla.errors import RobotError\n"
        f"load_client({first!r})\n"
        f"try: load_client({second!r})\n"
        "except RobotError as error: print(error.fault, error)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=240)
    assert done.stdout.startswith("backend ") and "one backend" in done.stdout, done.stderr


def test_a_client_that_is_not_installed_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pylibfranka", None)
    monkeypatch.delitem(sys.modules, "franky", raising=False)
    monkeypatch.delitem(sys.modules, "pylibfranka")
    monkeypatch.setattr(sys, "path", [])
    sys.path_importer_cache.clear()
    with pytest.raises(RobotError, match=r"\[franka-official\]") as caught:
        load_client("pylibfranka")
    assert caught.value.fault == "backend"


@pytest.mark.parametrize(
    "text, fault",
    [
        ("libfranka: Incompatible library version (server version: 9, library version: 10)", "version"),
        ("libfranka: Move command aborted: User Stop pressed!", "user_stop"),
        ('libfranka: Move command aborted: motion aborted by reflex! ["cartesian_reflex"]', "reflex"),
        ("libfranka: UDP receive: Timeout", "connection"),
        ("something else", "other"),
    ],
)
def test_the_clients_words_are_understood(text: str, fault: str) -> None:
    assert fault_of(text) == fault
