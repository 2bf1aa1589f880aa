"""What is asked of the hand and when it is at fault, on a fake client and a clock that is set."""

import os
import socket
import time
from contextlib import ExitStack

import pytest
from robot_fakes import FakeHand

from uniforce_robots.franka.clients import HAND_PORT, is_hand_closed
from uniforce_robots.franka.hand import Hand, HandCommand, HandSettings, next_command
from uniforce_vtla.errors import RobotError

SETTINGS = HandSettings()
TICK_s = 0.01


class Bench:
    def __init__(self, takes_s: float = 0.1, succeeds: bool = True) -> None:
        self.now_s = 100.0
        self.client = FakeHand(takes_s, succeeds, lambda: self.now_s)
        self.hand = Hand(self.client, SETTINGS, lambda: self.now_s)  # type: ignore[arg-type]
        self.hand.start()

    def run(self, for_s: float) -> str:
        for _ in range(round(for_s / TICK_s)):
            self.now_s += TICK_s
            try:
                self.hand.tick()
            except RobotError as error:
                return error.fault
        return ""

    def grasp(self) -> None:
        self.client.is_grasped = True
        self.hand.submit(0.02)
        assert self.run(0.5) == ""


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize(
    "target, last, wanted",
    [
        (0.06, None, HandCommand(0.06, 0.05)),
        (0.02, None, HandCommand(0.02, 0.05, 10.0)),
        (0.0585, HandCommand(0.06, 0.05), None),
        (0.05, HandCommand(0.06, 0.05), HandCommand(0.05, 0.05)),
        (0.03, HandCommand(0.06, 0.05), HandCommand(0.03, 0.05, 10.0)),
        (0.035, HandCommand(0.03, 0.05, 10.0), HandCommand(0.035, 0.05)),
    ],
)
def test_what_a_width_asks_for(target: float, last: HandCommand | None, wanted: HandCommand | None) -> None:
    assert next_command(target, last, SETTINGS) == wanted


def test_a_grasp_of_nothing_lies_outside_its_tolerance() -> None:
    for width in (0.0, 0.001, 0.01, 0.03):
        command = HandCommand(width, 0.05, 10.0)
        assert command.grasp_width_m - command.inner_m > 0.001 and command.inner_m >= 0


def test_commands_never_overlap_and_the_newest_target_wins(bench: Bench) -> None:
    for width in (0.07, 0.06, 0.05, 0.045, 0.03):
        bench.hand.submit(width)
        assert bench.run(0.02) == ""
    assert bench.run(0.3) == "" and not bench.hand.is_busy
    assert [c.width_m for c in bench.client.commands] == [0.07, 0.03], "the ones in between were skipped"
    assert bench.client.overlaps == 0 and bench.client.commands[-1].force_N == SETTINGS.grip_force_N


def test_small_changes_are_no_command(bench: Bench) -> None:
    for i in range(30):
        bench.hand.submit(0.06 + 0.0001 * min(i, 20))
        bench.run(TICK_s)
    assert len(bench.client.commands) == 1


def test_a_grasp_that_holds_nothing_is_counted_and_not_fatal() -> None:
    bench = Bench(succeeds=False)
    bench.hand.submit(0.02)
    assert bench.run(0.3) == "" and bench.hand.failed_grasps == 1
    bench.hand.submit(0.07)
    assert bench.run(0.3) == "" and len(bench.client.commands) == 2


@pytest.mark.parametrize("width", [None, float("nan"), float("inf"), -0.1, 0.5])
def test_a_lost_hand_and_a_width_that_cannot_be_are_faults_for_good(bench: Bench, width: float | None):
    if width is None:
        bench.client.fault = RobotError("gone", "hand_connection")
    else:
        bench.client.width_m = width
    fault = bench.run(TICK_s)
    assert fault == ("hand_connection" if width is None else "hand_state")
    bench.client.fault, bench.client.width_m = None, 0.08
    hand = bench.hand
    for use in (lambda: hand.submit(0.05), lambda: hand.reading, hand.check, hand.recover):
        with pytest.raises(RobotError) as caught:
            use()
        assert caught.value.fault == fault


def test_a_command_without_an_answer_is_a_fault_after_its_travel_and_half_a_second() -> None:
    bench = Bench(takes_s=60.0)
    bench.hand.submit(0.06)  # 20 mm at 50 mm/s
    assert bench.run(0.9) == "", "0.4 s of travel and 0.5 s"
    assert bench.run(0.1) == "hand_deadline"
    with pytest.raises(RobotError, match="in time"):
        bench.hand.recover()


def test_a_grasp_of_nothing_has_time_to_close_fully() -> None:
    bench = Bench(takes_s=1.65, succeeds=False)  # 80 mm at 50 mm/s take 1.6 s
    bench.hand.submit(0.035)
    assert bench.run(2.0) == "" and bench.hand.failed_grasps == 1


@pytest.mark.parametrize("width", [float("nan"), float("inf"), -0.01, 0.5])
def test_a_width_that_must_not_be_sent(bench: Bench, width: float) -> None:
    with pytest.raises(RobotError, match="width to send") as caught:
        bench.hand.submit(width)
    assert caught.value.fault == "guard" and not bench.client.commands


def test_old_readings_are_a_fault_while_they_are_old(bench: Bench) -> None:
    bench.client.silent_since_s = bench.now_s
    assert bench.run(0.49) == "" and bench.run(0.1) == "hand_stale"
    bench.client.silent_since_s = None
    bench.hand.recover()


def test_a_hand_that_hangs_up_is_noticed_though_its_client_waits_on(bench: Bench) -> None:
    bench.client.closed_by_hand = True
    assert bench.run(TICK_s) == "hand_connection"


def test_a_client_without_readings_during_a_command_is_bounded_by_the_deadline() -> None:
    bench = Bench(takes_s=0.7)
    bench.client.reads_while_busy = False
    bench.hand.submit(0.05)
    bench.run(TICK_s)
    bench.client.silent_since_s = bench.now_s
    assert bench.run(0.75) == "" and not bench.hand.is_busy
    bench.client.silent_since_s = None
    assert bench.run(1.0) == ""


def test_what_slips_out_is_a_fault_until_the_operators_word(bench: Bench) -> None:
    bench.grasp()
    bench.client.is_grasped = False
    assert bench.run(0.29) == "" and bench.run(0.03) == "grasp_lost"
    bench.hand.recover()
    assert bench.run(1.0) == ""


def test_opening_on_purpose_loses_nothing(bench: Bench) -> None:
    bench.grasp()
    bench.client.is_grasped = False
    bench.hand.submit(0.07)
    assert bench.run(1.0) == "" and len(bench.client.commands) == 2


def test_a_connection_that_the_hand_has_closed_is_seen_from_outside_the_client(address: str) -> None:
    with ExitStack() as closing:
        server = closing.enter_context(socket.create_server((address, HAND_PORT)))
        closing.enter_context(socket.create_connection((address, HAND_PORT)))
        accepted, _ = server.accept()
        assert not is_hand_closed(os.getpid())
        accepted.close()
        time.sleep(0.05)
        assert is_hand_closed(os.getpid())
