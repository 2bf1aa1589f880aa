"""Keys become commands and notes; an unattended session begins at once with one verdict."""

import os
import time

import pytest

from uniforce_robots.recorder.operators import Command, Event, KeyOperator, Phase, Unattended
from uniforce_robots.teleop.keyboard import TerminalKeys
from uniforce_vtla.errors import ContractError


def typed(operator: KeyOperator, keys: TerminalKeys, *pressed: str) -> list[Event]:
    for key in pressed:
        keys.press(key)
    return operator.poll(Phase.RUNNING)


def test_keys_mean_commands_and_unknown_ones_nothing() -> None:
    keys = TerminalKeys({"w": (0, 1)})
    operator = KeyOperator(keys, ["slow", "slipped"])
    events = typed(operator, keys, "space", "w", "up", "y")
    assert [event.command for event in events] == [Command.GO, Command.SUCCESS]
    assert typed(operator, keys, "2", "3") == [Event(Command.NOTE, "slipped")]
    assert operator.is_attended and not typed(operator, keys)


def test_a_note_is_typed_over_several_polls_and_may_hold_command_keys() -> None:
    keys = TerminalKeys({"w": (0, 1)})
    operator = KeyOperator(keys)
    assert not typed(operator, keys, "t", "Y", "x")
    assert not typed(operator, keys, "space", "z", "backspace", "q", "left")
    assert typed(operator, keys, "enter", "q") == [Event(Command.NOTE, "Yx q"), Event(Command.QUIT)]
    assert not typed(operator, keys, "t", "enter"), "an empty note is none"


def test_no_terminal_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    with pytest.raises(ContractError, match="operator=unattended"):
        KeyOperator().start()


def test_unattended() -> None:
    rule = Unattended("residual")
    said = {phase: [e.command for e in rule.poll(phase)] for phase in Phase}
    assert said[Phase.WAITING] == [Command.GO] and said[Phase.JUDGING] == [Command.RESIDUAL]
    assert not said[Phase.RUNNING] and not rule.is_attended
    with pytest.raises(ContractError, match="verdict"):
        Unattended("great")


def test_a_real_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = os.openpty()
    with os.fdopen(slave) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        operator = KeyOperator()
        operator.start()
        os.write(master, b"y q")
        said: list[Event] = []
        deadline_s = time.monotonic() + 30.0
        while len(said) < 3 and time.monotonic() < deadline_s:
            said += operator.poll(Phase.RUNNING)
            time.sleep(0.01)
        operator.stop()
        operator.stop()
    os.close(master)
    assert [event.command for event in said] == [Command.SUCCESS, Command.GO, Command.QUIT]
