"""The hand's thread on a fake hand: one command in flight, hysteresis, force, and nobody waits."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest
from robot_fakes import FakeHand

from uniforce_robots.franka.hand import HandCommand, HandSettings, HandThread, next_command
from uniforce_vtla.errors import RobotError

SETTINGS = HandSettings()


@pytest.fixture
def driver() -> FakeHand:
    return FakeHand()


@pytest.fixture
def hand(driver: FakeHand) -> Iterator[HandThread]:
    hand = HandThread(driver)
    hand.start()
    yield hand
    hand.stop()
    assert driver.closed and not [t for t in threading.enumerate() if t.name == "hand"]


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


def test_commands_never_overlap_and_the_newest_target_wins(
    hand: HandThread, driver: FakeHand, eventually: Callable
) -> None:
    for width in (0.07, 0.06, 0.05, 0.045, 0.03):
        hand.submit(width)
        time.sleep(0.02)
    eventually(lambda: not hand.is_busy and bool(driver.commands) and driver.commands[-1].width_m == 0.03)
    assert driver.overlaps == 0 and len(driver.commands) < 5, "the ones in between were skipped"
    assert driver.commands[-1].force_N == SETTINGS.grip_force_N


def test_small_changes_are_no_command(hand: HandThread, driver: FakeHand, eventually: Callable) -> None:
    hand.submit(0.06)
    eventually(lambda: len(driver.commands) == 1 and not hand.is_busy)
    for i in range(20):
        hand.submit(0.06 + 0.0001 * i)
        time.sleep(0.01)
    assert len(driver.commands) == 1


def test_nobody_waits_for_a_slow_hand(eventually: Callable) -> None:
    driver = FakeHand(read_s=0.5)
    hand = HandThread(driver)
    hand.start()
    calls, slowest = 50, 0.0
    for _ in range(calls):
        begun = time.thread_time()  # our own share: the machine's other work is not the hand's fault
        hand.submit(0.05)
        assert hand.reading.width_m == 0.08
        slowest = max(slowest, time.thread_time() - begun)
    assert slowest < 0.05
    begun = time.monotonic()
    for _ in range(calls):
        _ = hand.reading
    assert time.monotonic() - begun < calls * driver.read_s / 2
    hand.stop()


def test_a_grasp_that_holds_nothing_is_counted_and_not_fatal(eventually: Callable) -> None:
    driver = FakeHand(succeeds=False)
    hand = HandThread(driver)
    hand.start()
    hand.submit(0.02)
    eventually(lambda: hand.failed_grasps == 1)
    hand.submit(0.07)
    eventually(lambda: len(driver.commands) == 2)
    assert hand.fault is None
    hand.stop()


def test_a_lost_hand_is_told_to_everybody(hand: HandThread, driver: FakeHand, eventually: Callable) -> None:
    driver.fault = RobotError("gone", "connection")
    eventually(lambda: hand.fault is not None)
    with pytest.raises(RobotError, match="gone"):
        hand.submit(0.05)
    with pytest.raises(RobotError, match="gone"):
        _ = hand.reading


def test_a_command_in_flight_is_stopped_at_the_end(eventually: Callable) -> None:
    driver = FakeHand(takes_s=60.0)
    hand = HandThread(driver)
    hand.start()
    hand.submit(0.05)
    eventually(lambda: hand.is_busy)
    hand.stop()
    assert driver.stops == 1 and driver.closed


# --- what stops the arm ----------------------------------------------------------------------------------------------


def checked(hand: HandThread) -> str:
    """Return the fault the arm's thread would see, empty while all is well."""
    try:
        hand.check()
    except RobotError as error:
        return error.fault
    return ""


def test_a_command_without_an_answer_is_a_fault_after_its_travel_and_half_a_second(
    eventually: Callable,
) -> None:
    driver = FakeHand(takes_s=60.0)
    hand = HandThread(driver)
    hand.start()
    hand.submit(0.06)  # 20 mm at 50 mm/s
    eventually(lambda: hand.is_busy)
    begun = time.monotonic()
    assert checked(hand) == ""
    eventually(lambda: checked(hand) == "hand_deadline")
    assert time.monotonic() - begun > 0.8, "0.4 s of travel and 0.5 s"
    with pytest.raises(RobotError, match="in time"):
        hand.recover()
    hand.stop()


def test_a_grasp_of_nothing_has_time_to_close_fully(eventually: Callable) -> None:
    driver = FakeHand(takes_s=1.65, succeeds=False)  # 80 mm at 50 mm/s take 1.6 s
    hand = HandThread(driver)
    hand.start()
    hand.submit(0.035)
    eventually(lambda: hand.is_busy)
    while hand.is_busy:
        assert checked(hand) == ""
        time.sleep(0.01)
    assert hand.failed_grasps == 1
    hand.stop()


@pytest.mark.parametrize("width", [float("nan"), float("inf"), -0.01, 0.5])
def test_a_width_that_must_not_be_sent(hand: HandThread, driver: FakeHand, width: float) -> None:
    with pytest.raises(RobotError, match="width to send") as caught:
        hand.submit(width)
    assert caught.value.fault == "guard" and not driver.commands


def test_old_readings_are_a_fault(hand: HandThread, driver: FakeHand, eventually: Callable) -> None:
    assert checked(hand) == ""
    driver.silent_since_s = time.monotonic()
    eventually(lambda: checked(hand) == "hand_stale")
    driver.silent_since_s = None
    eventually(lambda: checked(hand) == "")
    hand.recover()


def test_a_hand_that_hangs_up_is_noticed_though_its_client_waits_on(
    hand: HandThread, driver: FakeHand
) -> None:
    driver.read_s = 0.4
    driver.closed_by_peer = True
    assert checked(hand) == "hand_connection"


def test_a_client_without_readings_during_a_command_is_bounded_by_the_deadline(eventually: Callable) -> None:
    driver = FakeHand(takes_s=0.7)
    driver.reads_while_busy = False
    hand = HandThread(driver)
    hand.start()
    hand.submit(0.05)
    eventually(lambda: hand.is_busy)
    driver.silent_since_s = time.monotonic()
    while hand.is_busy:
        assert checked(hand) == ""
        time.sleep(0.01)
    driver.silent_since_s = None
    eventually(lambda: checked(hand) == "")
    hand.stop()


def test_what_slips_out_is_a_fault_until_the_operators_word(
    hand: HandThread, driver: FakeHand, eventually: Callable
) -> None:
    driver.is_grasped = True
    hand.submit(0.02)
    eventually(lambda: not hand.is_busy and bool(driver.commands))
    time.sleep(0.1)
    assert checked(hand) == ""
    driver.is_grasped = False
    eventually(lambda: checked(hand) == "grasp_lost")
    hand.recover()
    assert checked(hand) == ""


def test_opening_on_purpose_loses_nothing(hand: HandThread, driver: FakeHand, eventually: Callable) -> None:
    driver.is_grasped = True
    hand.submit(0.02)
    eventually(lambda: not hand.is_busy and len(driver.commands) == 1)
    time.sleep(0.1)
    driver.is_grasped = False
    hand.submit(0.07)
    eventually(lambda: not hand.is_busy and len(driver.commands) == 2)
    time.sleep(0.5)
    assert checked(hand) == ""


@pytest.mark.parametrize("width", [float("nan"), float("inf"), -0.1, 0.5])
def test_a_width_that_cannot_be_is_a_fault(
    hand: HandThread, driver: FakeHand, eventually: Callable, width: float
) -> None:
    driver.width_m = width
    eventually(lambda: checked(hand) == "hand_state")
    with pytest.raises(RobotError):
        hand.submit(0.05)


def test_a_mistake_in_a_driver_is_a_fault_too(
    hand: HandThread, driver: FakeHand, eventually: Callable
) -> None:
    driver.read = lambda: 1 / 0  # type: ignore[method-assign, assignment, return-value]
    eventually(lambda: checked(hand) == "other")
