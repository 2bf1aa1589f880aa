"""Training hears part of the touch as another sensor would tell it; a rollout never does, and no checkpoint knows."""

from __future__ import annotations

import json
import shutil
from types import SimpleNamespace

import pytest
import torch

from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.transferred_touch import TransferredTouch
from uniforce_vtla.errors import CheckpointError, ContractError, DatasetError
from uniforce_vtla.keys import VIEW_MARKER
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.sensor_transfer import SensorTransfer

KINDS = ("tactip", "uskin")
NUMBERS = 96
ORIGIN = 0.25  # of free air along the directions
DISAGREEMENT = torch.tensor([0.1, 0.3, 0.9])  # of fingers along the first three


def maps(tokenizer_hash="", shift=7.0):
    """A uSkin says what a TacTip says, and ``shift`` more; both without doubt."""
    transfer = SensorTransfer(KINDS, NUMBERS, tokenizer_hash)
    transfer.matrix.copy_(torch.eye(NUMBERS))
    transfer.offset[0, 1] = shift
    transfer.directions.copy_(torch.eye(NUMBERS)[:, : transfer.directions.shape[1]])
    transfer.origin.fill_(ORIGIN)
    transfer.disagreement[: len(DISAGREEMENT)] = DISAGREEMENT
    return transfer


def test_a_share_of_the_samples_is_told_by_each_known_sensor():
    transferred = TransferredTouch(maps(), ["uskin", "tactip"], share=0.6, doubt=1.0)
    touch = torch.randn(4000, 16, 6)
    moved = (transferred(touch, 1) - touch).mean(dim=(1, 2))
    assert torch.all((moved.abs() < 1e-4) | ((moved - 7).abs() < 1e-4))
    assert (
        0.27 < float((moved > 1).float().mean()) < 0.33
    )  # half of .6: the slot's own kind is drawn as often
    assert torch.allclose(transferred(touch, 0), touch, atol=1e-5)


def test_doubt_is_noise_of_its_size():
    transfer = maps(shift=0.0)
    transfer.doubt[:] = 0.3 * torch.eye(NUMBERS)
    felt = torch.ones(500, 16, 6)  # loudness 1: rest is 0, units are 1
    for doubt in (0.0, 0.5, 1.0):
        told = TransferredTouch(transfer, ["tactip"], share=1.0, doubt=doubt)(felt, 0)
        assert float(told.std()) == pytest.approx(0.3 * doubt, abs=0.01)


@pytest.mark.parametrize("doubt", [-0.1, 1.5])
def test_no_more_doubt_than_there_is(doubt, make_config):
    with pytest.raises(ContractError, match="sensor_transfer_doubt"):
        make_config(sensor_transfer_doubt=doubt)


@pytest.fixture
def view(tokenizer_path, tmp_path):
    """What a trainer hands a policy: the facts of a training view, its tokenizer with maps."""
    tokenizer = Tokenizer.from_pretrained(tokenizer_path)
    folder = tmp_path / "tokenizer"
    shutil.copytree(tokenizer_path, folder)
    maps(tokenizer.hash).save(folder / "transfer", {})
    (tmp_path / VIEW_MARKER).write_text(json.dumps({"tokenizer_hash": tokenizer.hash}))
    sensors = {"right": ["tactip"], "left": ["gelsight", "uskin"]}
    return SimpleNamespace(root=tmp_path, tokenizer=str(folder), sensors=sensors)


def trained(make_config, view, **settings):
    given = {"tokenizer_path": view.tokenizer, "touch_slots": {"touch0": "right"}, "sensor_transfer": 1.0}
    return PI05UniforcePolicy(make_config(**{**given, **settings}), dataset_meta=view)


def test_only_training_hears_other_sensors_and_the_checkpoint_stays_as_it_was(make_config, view, tmp_path):
    policy = trained(make_config, view, touch_noise=0.0)
    tokens, felt = policy.model.force_tokens, torch.randn(64, 16, 6)
    plain = tokens.eval()(felt, 0)
    heard = tokens.train()(felt, 0)
    changed = (heard - plain).abs().amax(dim=(1, 2)) > 1e-3
    assert 0.3 < float(changed.float().mean()) < 0.7
    assert not [name for name in policy.state_dict() if "transferred" in name]
    policy.save_pretrained(tmp_path / "saved")
    again = PI05UniforcePolicy.from_pretrained(tmp_path / "saved")
    assert again.model.force_tokens.transferred is None and again.config.sensor_transfer == 1.0
    resumed = PI05UniforcePolicy.from_pretrained(tmp_path / "saved", dataset_meta=view)
    assert resumed.model.force_tokens.transferred is not None


def test_without_maps_nothing_is_transferred(make_config, view):
    assert trained(make_config, view, sensor_transfer=0.0).model.force_tokens.transferred is None


@pytest.mark.parametrize(
    ("settings", "error", "said"),
    [
        ({"touch_slots": {"touch0": "left"}}, ContractError, r"gelsight\+uskin"),  # two kinds in one slot
        ({"trained_sensors": {"touch0": "digit"}}, ContractError, "digit"),
        ({"latent_grid": 2}, ContractError, "latent_grid"),
        (
            {"tokenizer_path": None},
            DatasetError,
            "tokenizer of",
        ),  # the shipped one has maps, but isn't the view's
    ],
)
def test_maps_that_do_not_fit_are_refused(settings, error, said, make_config, view):
    with pytest.raises(error, match=said):
        trained(make_config, view, **settings)


def test_training_without_a_view_is_refused_and_not_done_without_maps(make_config):
    tokens = PI05UniforcePolicy(make_config(sensor_transfer=0.5)).model.force_tokens
    felt = torch.randn(2, 16, 6)
    assert tokens.eval()(felt, 0).isfinite().all()
    with pytest.raises(ContractError, match="dataset_meta"):
        tokens.train()(felt, 0)


def test_maps_of_another_tokenizer_are_refused(make_config, view):
    maps("another").save(f"{view.tokenizer}/transfer", {})
    with pytest.raises(CheckpointError, match="uniforce-sensor-transfer"):
        trained(make_config, view)


@pytest.mark.parametrize(
    "settings", [{"sensor_transfer": 1.5}, {"touch_input": "wrench", "sensor_transfer": 0.5}]
)
def test_a_share_of_latents_it_must_be(settings, make_config):
    with pytest.raises(ContractError, match="sensor_transfer"):
        make_config(**settings)


def test_directions_are_all_that_is_heard_and_come_back_with_the_checkpoint(make_config, view, tmp_path):
    policy = trained(make_config, view, sensor_transfer=0.0, touch_directions=3)
    tokens, felt = policy.model.force_tokens.eval(), torch.randn(4, 16, 6)
    other = felt + torch.randn_like(felt)
    other.flatten(1)[:, :3] = felt.flatten(1)[:, :3]  # maps() names the first numbers as the agreed ones
    assert torch.equal(tokens(felt, 0), tokens(other, 0))
    other.flatten(1)[:, 2] += 0.5
    assert not torch.allclose(tokens(felt, 0), tokens(other, 0))
    assert torch.allclose(tokens.origin, torch.full((3,), ORIGIN))
    shutil.rmtree(f"{view.tokenizer}/transfer")  # of no use any more
    policy.save_pretrained(tmp_path / "saved")
    again = PI05UniforcePolicy.from_pretrained(tmp_path / "saved").model.force_tokens
    assert torch.equal(again(felt, 0), tokens(felt, 0))


def test_noise_along_directions_is_what_fingers_of_a_grasp_disagree_by(make_config, view, tmp_path):
    policy = trained(make_config, view, sensor_transfer=0.0, touch_directions=3, touch_noise=0.5)
    policy.save_pretrained(tmp_path / "saved")
    tokens = PI05UniforcePolicy.from_pretrained(
        tmp_path / "saved"
    ).model.force_tokens  # training goes on with it
    heard = []
    tokens.proj.register_forward_pre_hook(lambda _, given: heard.append(given[0]))
    felt = torch.randn(1, 16, 6).expand(4000, 16, 6)
    tokens.eval()(felt, 0)
    tokens.train()(felt, 0)
    assert torch.allclose((heard[1] - heard[0]).std(dim=(0, 1)), 0.5 * DISAGREEMENT, rtol=0.1)


def test_directions_need_the_tokenizers_own_maps(make_config, view):
    maps("another").save(f"{view.tokenizer}/transfer", {})
    with pytest.raises(CheckpointError, match="uniforce-sensor-transfer"):
        PI05UniforcePolicy(make_config(tokenizer_path=view.tokenizer, touch_directions=3))


@pytest.mark.parametrize(
    "settings", [{"touch_directions": 17}, {"touch_input": "wrench", "touch_directions": 2}]
)
def test_directions_are_of_latents_and_few(settings, make_config):
    with pytest.raises(ContractError, match="touch_directions"):
        make_config(**settings)
