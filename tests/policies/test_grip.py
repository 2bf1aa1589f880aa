"""A grip that can't be read: when it is held, what is said of it, and what demonstrations tell of it."""

from types import SimpleNamespace

import pytest
import torch

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import (
    PI05UniforceConfig,
    TouchSettings,
)
from lerobot_policy_pi05_uniforce.touch.sensors import carried_grip, held_grips
from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.newtons import Lift, Newtons

TABLE_m, CARRIED_m = 0.03, 0.075
READ_N, HELD_N = 12.0, 8.9


# a head whose newtons are its latents
HEAD = SimpleNamespace(step=lambda latent, state: (latent[:, 0], None))


def tiny(grip="", **touch):
    return PI05UniforceConfig(size="tiny", device="cpu", grip=grip, touch=TouchSettings(**touch))


def given(newtons, height_m, grip_N):
    latent = torch.tensor([[[0.3, -2.5, grip_N]]])
    return newtons(latent, torch.tensor([height_m]))[0].tolist()


def test_a_grip_is_as_read_until_the_hand_has_lifted_and_the_stored_one_from_then_on():
    newtons = Newtons(HEAD, held_N=HELD_N)
    # moving about, closing on the table, lifting, and pressing on the board, lower than it carried
    way = [(0.09, 0.0), (TABLE_m, 0.0), (TABLE_m, READ_N), (CARRIED_m, READ_N), (0.04, READ_N)]
    read_N = [given(newtons, *moment) for moment in way]
    assert [fz for *_, fz in read_N] == pytest.approx([0.0, 0.0, READ_N, HELD_N, HELD_N])
    for fx, fy, _ in read_N:
        assert (fx, fy) == pytest.approx((0.3, -2.5)), "shear is felt"


def test_fingers_that_hold_nothing_are_never_said_to_hold():
    newtons = Newtons(HEAD, held_N=HELD_N)
    given(newtons, TABLE_m, READ_N)
    given(newtons, CARRIED_m, READ_N)
    assert given(newtons, CARRIED_m, 0.1)[2] == pytest.approx(0.1)
    assert given(newtons, CARRIED_m, READ_N)[2] == pytest.approx(HELD_N)
    newtons.reset()
    assert given(newtons, CARRIED_m, READ_N)[2] == pytest.approx(READ_N), "another episode"


def test_each_environment_of_a_batch_lifts_for_itself():
    lift = Lift()
    grips_N = torch.full((2,), READ_N)
    assert not lift.see(torch.tensor([TABLE_m, TABLE_m]), grips_N).any()
    assert lift.see(torch.tensor([CARRIED_m, TABLE_m]), grips_N).tolist() == [True, False]


def calibration(r2):
    return SimpleNamespace(reads_grip=r2 >= 0.9, grip_in_words=f"R² {r2}")


@pytest.mark.parametrize(
    "grip, r2, holds",
    [
        ("", 0.85, True),
        ("", 0.95, False),
        ("", None, False),
        ("read", 0.85, False),
        ("held", 0.95, True),
    ],
)
def test_calibrations_decide_and_a_user_overrides(grip, r2, holds):
    carried_N = {"touch0": HELD_N}
    calibrations = {} if r2 is None else {"right": calibration(r2)}
    held_N, notes = held_grips(tiny(grip, carried_N=carried_N), calibrations)
    assert held_N == (carried_N if holds else {})
    assert bool(notes) == holds and all("grip held at 8.9 N" in note for note in notes)


def test_a_checkpoint_that_knows_no_grip_reads_it_and_refuses_to_hold(caplog):
    assert held_grips(tiny(), {"right": calibration(0.85)}) == ({}, [])
    assert "taken as read" in caplog.text
    with pytest.raises(ContractError, match="carried_N"):
        held_grips(tiny("held"), {})


@pytest.mark.parametrize("held_N", [0.0, -1.0, float("nan"), float("inf"), 1e3, "8.9", None])
def test_a_stored_grip_that_cannot_be_is_refused(held_N):
    with pytest.raises(ContractError, match="carried_N"):
        tiny(carried_N={"touch0": held_N})


def test_the_choice_is_never_stored(tmp_path):
    tiny("read").save_pretrained(tmp_path)
    assert PI05UniforceConfig.from_pretrained(tmp_path).grip == ""


def test_demonstrations_tell_what_is_carried():
    states, forces = torch.zeros(6, 5), torch.zeros(6, 3)
    states[:, 2] = torch.tensor([0.09, TABLE_m, TABLE_m, CARRIED_m, CARRIED_m, CARRIED_m])
    forces[:, 2] = torch.tensor([0.0, 0.0, 7.0, 8.0, 9.0, 10.0])
    assert carried_grip([(states, forces)]) == pytest.approx(9.0)
    assert carried_grip([(states[:3], forces[:3])]) is None


def test_grip_is_held_from_the_first_touch_on():
    newtons = Newtons(HEAD, held_N=10.5, from_touch=True)
    felt = newtons(torch.tensor([[[0.1, -2.0, 0.3]], [[0.1, -2.0, 4.0]], [[0.1, -2.0, 17.0]]]))
    assert felt[:, 2].tolist() == pytest.approx([0.3, 10.5, 10.5])
    assert felt[:, 1].tolist() == [-2.0] * 3
