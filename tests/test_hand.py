"""Commands to the hand and its faults, on a fake client and a clock that is set."""

import pytest
from hand_fakes import FakeHand

from uniforce_robots.franka.clients import HandReading
from uniforce_vtla.errors import RobotError
from uniforce_vtla.hand import TRIES, GRACE_s, Hand, HandCommand, HandRules, next_command

SETTINGS = HandRules()
TICK_s = 0.01


class Bench(FakeHand):
    """A hand on a clock that is set, and the program that drives it."""

    def __init__(self, takes_s=0.1, moves=False):
        super().__init__(takes_s, lambda: self.now_s, moves)
        self.now_s = 100.0
        self.hand = Hand(self, SETTINGS, self.clock)
        self.hand.start()

    def run(self, for_s):
        for _ in range(round(for_s / TICK_s)):
            self.now_s += TICK_s
            try:
                self.hand.tick()
            except RobotError as error:
                return error.fault
        return ""

    def wish(self, width_m, for_s):
        """Wish a width and run on without a fault."""
        self.hand.submit(width_m)
        assert self.run(for_s) == ""

    def grasp(self):
        self.is_grasped = True
        self.wish(0.02, 0.5)


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def moving():
    return Bench(moves=True)


OPEN, HALF, HELD = (
    HandReading(0.0, width_m, 0.08, held) for width_m, held in ((0.08, 0), (0.05, 0), (0.035, 1))
)
GRASP = SETTINGS.speed_m_s, SETTINGS.grip_force_N


@pytest.mark.parametrize(
    "wish, reading, wanted",
    [
        # a wrist may be there: closing has a bounded force from the start
        (0.06, OPEN, HandCommand(0.06, *GRASP)),
        (0.02, HALF, HandCommand(0.02, *GRASP)),
        (0.06, HALF, HandCommand(0.06, SETTINGS.speed_m_s)),
        (0.0485, HALF, None),
        (0.02, HELD, None),  # as close as it can be
        (0.0375, HELD, None),
        (0.04, HELD, HandCommand(0.04, SETTINGS.speed_m_s)),
    ],
)
def test_what_a_width_asks_for(wish, reading, wanted):
    assert next_command(wish, reading.width_m, reading.is_grasped, SETTINGS) == wanted


@pytest.mark.parametrize("object_m", [0.0, 0.055, 0.07])
def test_fingers_that_close_stop_where_wished_and_bound_their_force_from_the_widest_on(
    object_m, moving
):
    moving.object_m = object_m
    moving.wish(0.05, 2.0)
    assert [c.force_N for c in moving.commands] == [SETTINGS.grip_force_N]
    assert moving.width_m == pytest.approx(object_m or 0.05, abs=0.001)
    moving.wish(0.06 if object_m < 0.06 else 0.075, 2.0)
    assert moving.commands[-1].force_N == 0


def test_a_wish_that_changes_on_the_way_is_obeyed_where_it_is_reached(moving):
    moving.wish(0.0, 0.4)
    moving.wish(moving.hand.reading.width_m, 1.0)  # stay
    assert moving.width_m == pytest.approx(0.06, abs=0.002) and moving.stops == 1
    moving.wish(0.08, 0.2)
    moving.wish(0.06, 1.0)
    assert moving.width_m == pytest.approx(0.06, abs=0.001), (
        "past it already: stopped, and led back"
    )


@pytest.mark.parametrize("how", ["stop", "halt"])
def test_a_stop_ends_the_fingers_way_and_forgets_what_was_wished(how, moving):
    moving.wish(0.06, 0.1)
    moving.hand.submit(0.0)  # waits for its turn
    getattr(moving.hand, how)()
    before_m = moving.width_m
    assert moving.run(2.0) == "" and abs(moving.width_m - before_m) < 0.001
    moving.hand.recover()
    assert moving.run(2.0) == "" and len(moving.commands) == 1, "recovery begins nothing"
    moving.wish(before_m, 1.0)
    assert len(moving.commands) == 1, "nor does a wish to stay"
    moving.wish(0.06, 2.0)
    assert moving.width_m == pytest.approx(0.06, abs=0.001), "a new wish does"


def test_what_is_held_stays_held_over_a_stop(moving):
    moving.object_m = 0.03
    moving.wish(0.02, 2.0)
    assert moving.is_grasped
    moving.hand.stop()
    moving.run(0.1)
    moving.hand.halt()
    moving.hand.recover()
    moving.wish(0.03, 1.0)
    assert moving.is_grasped
    assert moving.stops == 0 and len(moving.commands) == 1


def test_a_grip_that_wanders_by_more_than_the_hysteresis_stays_a_grasp(moving):
    moving.object_m = 0.035
    for width_m in (0.020, 0.0235) * 3:
        moving.wish(width_m, 1.5)
    assert [c.force_N for c in moving.commands] == [SETTINGS.grip_force_N]


@pytest.mark.parametrize("says", [False, True])
def test_what_slips_out_is_known_though_the_wish_went_on_after_the_grasp_began(says, moving):
    """Guards raise a wish step by step: the grasp was asked for at another width than is wished
    when it is lost."""
    moving.object_m = 0.035
    moving.wish(0.07, 0.05)
    moving.wish(0.02, 1.5)
    assert moving.is_grasped
    moving.width_m = 0.003  # on the way to nothing, the hand still says that it holds
    assert moving.run(0.1) == ""
    moving.is_grasped, moving.width_m = says, 0.0
    assert moving.run(0.5) == "grasp_lost"
    assert len(moving.commands) == 1, "opening fingers would hide it"


def test_a_hand_that_opens_less_opens_as_far_as_it_goes_and_one_never_homed_is_named(moving):
    moving.width_m, moving.max_width_m = 0.02, 0.0785
    moving.wish(0.08, 3.0)
    assert moving.width_m == 0.0785
    moving.max_width_m = 0.0
    with pytest.raises(RobotError, match="Home the hand in Desk"):
        moving.hand.start()


def test_a_grasp_of_nothing_lies_outside_its_tolerance():
    for width in (0.0, 0.001, 0.01, 0.03):
        command = HandCommand(width, 0.05, 10.0)
        assert command.grasp_width_m - command.inner_m > 0.001 and command.inner_m >= 0


def test_commands_never_overlap_and_the_newest_target_wins(bench):
    bench.width_m = 0.02
    for width in (0.03, 0.04, 0.05, 0.055, 0.07):
        bench.wish(width, 0.02)
    assert bench.run(0.3) == "" and not bench.hand.is_busy
    assert [c.width_m for c in bench.commands] == [0.03, 0.07], "the ones in between were skipped"
    assert bench.overlaps == 0


def test_a_command_that_fails_is_tried_again_counted_and_not_fatal(bench):
    bench.width_m = 0.02
    bench.begin = bench.commands.append  # the fingers don't move
    bench.poll = lambda: False
    for tried, width_m in enumerate((0.07, 0.05), 1):
        bench.wish(width_m, 1.0)
        assert len(bench.commands) == bench.hand.failed_commands == TRIES * tried


@pytest.mark.parametrize("width", [None, float("nan"), float("inf"), -0.1, 0.5])
def test_a_lost_hand_and_a_width_that_cannot_be_are_faults_for_good(bench, width):
    if width is None:
        bench.fault = RobotError("gone", "hand_connection")
    else:
        bench.width_m = width
    fault = bench.run(TICK_s)
    assert fault == ("hand_connection" if width is None else "hand_state")
    bench.fault, bench.width_m = None, 0.08
    hand = bench.hand
    for use in (lambda: hand.submit(0.05), lambda: hand.reading, hand.check, hand.recover):
        with pytest.raises(RobotError) as caught:
            use()
        assert caught.value.fault == fault


def test_a_command_without_an_answer_is_a_fault_after_its_travel_and_half_a_second():
    bench = Bench(takes_s=60.0)
    bench.hand.submit(0.06)  # a grasp may close fully: 80 mm at 50 mm/s
    assert bench.run(1.6 + GRACE_s) == ""
    assert bench.run(0.02) == "hand_deadline"
    with pytest.raises(RobotError, match="in time"):
        bench.hand.recover()


@pytest.mark.parametrize("width", [float("nan"), float("inf"), -0.01, 0.5])
def test_a_width_that_must_not_be_sent(bench, width):
    with pytest.raises(RobotError, match="width to send") as caught:
        bench.hand.submit(width)
    assert caught.value.fault == "guard" and not bench.commands


def test_old_readings_are_a_fault_while_they_are_old(bench):
    bench.silent_since_s = bench.now_s
    assert bench.run(0.49) == "" and bench.run(0.1) == "hand_stale"
    bench.silent_since_s = None
    bench.hand.recover()


def test_a_hand_that_hangs_up_is_noticed_though_its_client_waits_on(bench):
    bench.closed_by_hand = True
    assert bench.run(TICK_s) == "hand_connection"


def test_what_slips_out_is_a_fault_until_the_operators_word(bench):
    bench.grasp()
    bench.is_grasped = False
    assert bench.run(0.29) == "" and bench.run(0.03) == "grasp_lost"
    commands = len(bench.commands)
    bench.hand.recover()
    assert bench.run(1.0) == "" and len(bench.commands) == commands, "nothing is begun"
    bench.width_m = 0.08  # a person opened it and put the object back
    bench.wish(0.02, 1.0)
    assert len(bench.commands) == commands + 1, "the same wish, asked for anew"


def test_opening_on_purpose_loses_nothing(bench):
    bench.grasp()
    bench.is_grasped = False
    bench.wish(0.07, 1.0)
    assert len(bench.commands) == 2
