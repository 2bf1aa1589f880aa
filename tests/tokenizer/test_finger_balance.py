"""Two fingers' grip: compared over ten seconds, once an episode."""

import pytest

from uniforce_vtla.tokenizer.finger_balance import LOOKS, USUAL, FingerBalance, imbalance


def judged(balance, own_N, other_N):
    return [times for _ in range(2 * LOOKS) if (times := balance.see(own_N, other_N)) is not None]


def test_an_episode_is_judged_once_and_the_next_one_anew():
    balance = FingerBalance()
    assert judged(balance, 8.0, 4.0) == [2.0] and balance.done
    balance.reset()
    assert judged(balance, 4.0, 8.0) == [0.5]


def test_an_open_hand_is_not_compared():
    balance = FingerBalance()
    assert not judged(balance, 0.3, 5.0)
    assert judged(balance, 8.0, 8.0) == [1.0]


def test_a_finger_that_reads_nothing_gives_a_number():
    (times,) = judged(FingerBalance(), 8.0, -0.1)
    assert times > 100 and imbalance(times) > 1


@pytest.mark.parametrize(
    "times, alarm", [(USUAL, False), (1.2, False), (0.9, False), (1.4, True), (0.75, True)]
)
def test_what_clean_wipes_show_raises_no_alarm(times, alarm):
    assert (imbalance(times) > 1) == alarm
