"""Training maps part of the latents to other sensors; a rollout never does, and no checkpoint holds the maps."""

import json
import shutil
from types import SimpleNamespace

import pytest
import torch

from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.touch.transfer import TransferredTouch
from uniforce_vtla.errors import CheckpointError, ContractError, DatasetError
from uniforce_vtla.keys import VIEW_MARKER
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.sensor_transfer import SensorTransfer

KINDS = ("tactip", "uskin")
NUMBERS = 96
ORIGIN = 0.25  # of free air along the directions
DISAGREEMENT = torch.tensor([0.1, 0.3, 0.9])  # of fingers along the first three


def maps(tokenizer_hash="", shift=7.0):
    """A uSkin's latents are a TacTip's plus ``shift``; both without spread."""
    transfer = SensorTransfer(KINDS, NUMBERS, tokenizer_hash)
    transfer.matrix.copy_(torch.eye(NUMBERS))
    transfer.offset[0, 1] = shift
    transfer.directions.copy_(torch.eye(NUMBERS)[:, : transfer.directions.shape[1]])
    transfer.origin.fill_(ORIGIN)
    transfer.disagreement[: len(DISAGREEMENT)] = DISAGREEMENT
    return transfer


def test_a_share_of_the_samples_is_mapped_to_each_known_sensor():
    transferred = TransferredTouch(maps(), ["uskin", "tactip"], share=0.6)
    touch = torch.randn(4000, 16, 6)
    moved = (transferred(touch, 1) - touch).mean(dim=(1, 2))
    assert torch.all((moved.abs() < 1e-4) | ((moved - 7).abs() < 1e-4))
    # half of .6: the slot's own kind is drawn as often
    assert 0.27 < float((moved > 1).float().mean()) < 0.33
    assert torch.allclose(transferred(touch, 0), touch, atol=1e-5)


def test_the_maps_spread_is_drawn_by_a_quarter():
    transfer = maps(shift=0.0)
    transfer.noise_scale[:] = 0.3 * torch.eye(NUMBERS)
    touch = torch.ones(500, 16, 6)  # of magnitude 1: rest is 0, units are 1
    for spread, drawn in (({}, 0.25), ({"spread": 0.0}, 0.0), ({"spread": 1.0}, 1.0)):
        mapped = TransferredTouch(transfer, ["tactip"], share=1.0, **spread)(touch, 0)
        assert float(mapped.std()) == pytest.approx(0.3 * drawn, abs=0.01)


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
    given = {"touch__tokenizer_path": view.tokenizer, "touch__slots": {"touch0": "right"}}
    given |= {"augment__sensor_transfer": 1.0}
    return PI05UniforcePolicy(make_config(**{**given, **settings}), dataset_meta=view)


def test_only_training_is_mapped_and_the_checkpoint_stays_as_it_was(make_config, view, tmp_path):
    policy = trained(make_config, view, augment__touch_noise=0.0)
    tokens, touch = policy.model.force_tokens, torch.randn(64, 16, 6)
    plain = tokens.eval()(touch, 0)
    mapped = tokens.train()(touch, 0)
    changed = (mapped - plain).abs().amax(dim=(1, 2)) > 1e-3
    assert 0.3 < float(changed.float().mean()) < 0.7
    assert not [name for name in policy.state_dict() if "transferred" in name]
    policy.save_pretrained(tmp_path / "saved")
    again = PI05UniforcePolicy.from_pretrained(tmp_path / "saved")
    assert again.model.force_tokens.transferred is None and again.config.augment.sensor_transfer == 1.0
    resumed = PI05UniforcePolicy.from_pretrained(tmp_path / "saved", dataset_meta=view)
    assert resumed.model.force_tokens.transferred is not None


@pytest.mark.parametrize(
    ("settings", "error", "said"),
    [
        ({"touch__slots": {"touch0": "left"}}, ContractError, r"gelsight\+uskin"),  # two kinds in one slot
        ({"touch__trained_sensors": {"touch0": "digit"}}, ContractError, "digit"),
        # the shipped one has maps, but isn't the view's
        ({"touch__tokenizer_path": None}, DatasetError, "tokenizer of"),
    ],
)
def test_maps_that_do_not_fit_are_refused(settings, error, said, make_config, view):
    with pytest.raises(error, match=said):
        trained(make_config, view, **settings)


def test_training_without_a_view_is_refused_and_not_done_without_maps(make_config):
    tokens = PI05UniforcePolicy(make_config(augment__sensor_transfer=0.5)).model.force_tokens
    touch = torch.randn(2, 16, 6)
    assert tokens.eval()(touch, 0).isfinite().all()
    with pytest.raises(ContractError, match="dataset_meta"):
        tokens.train()(touch, 0)


def test_directions_are_all_that_counts_and_come_back_with_the_checkpoint(make_config, view, tmp_path):
    policy = trained(make_config, view, augment__sensor_transfer=0.0, touch__directions=3)
    tokens, touch = policy.model.force_tokens.eval(), torch.randn(4, 16, 6)
    other = touch + torch.randn_like(touch)
    other.flatten(1)[:, :3] = touch.flatten(1)[:, :3]  # maps() names the first numbers as the agreed ones
    assert torch.equal(tokens(touch, 0), tokens(other, 0))
    other.flatten(1)[:, 2] += 0.5
    assert not torch.allclose(tokens(touch, 0), tokens(other, 0))
    assert torch.allclose(tokens.origin, torch.full((3,), ORIGIN))
    shutil.rmtree(f"{view.tokenizer}/transfer")  # of no use any more
    policy.save_pretrained(tmp_path / "saved")
    again = PI05UniforcePolicy.from_pretrained(tmp_path / "saved").model.force_tokens
    assert torch.equal(again(touch, 0), tokens(touch, 0))


def test_noise_along_directions_is_what_fingers_of_a_grasp_disagree_by(make_config, view, tmp_path):
    touch = {"touch__directions": 3, "augment__touch_noise": 0.5, "augment__sensor_transfer": 0.0}
    policy = trained(make_config, view, **touch)
    policy.save_pretrained(tmp_path / "saved")
    # training goes on with it
    tokens = PI05UniforcePolicy.from_pretrained(tmp_path / "saved").model.force_tokens
    read = []
    tokens.proj.register_forward_pre_hook(lambda _, given: read.append(given[0]))
    touch = torch.randn(1, 16, 6).expand(4000, 16, 6)
    tokens.eval()(touch, 0)
    tokens.train()(touch, 0)
    assert torch.allclose((read[1] - read[0]).std(dim=(0, 1)), 0.5 * DISAGREEMENT, rtol=0.1)


@pytest.mark.parametrize("settings", [{}, {"augment__sensor_transfer": 0.0, "touch__directions": 3}])
def test_maps_of_another_tokenizer_are_refused(settings, make_config, view):
    maps("another").save(f"{view.tokenizer}/transfer", {})
    with pytest.raises(CheckpointError, match=r"benchmarks\.sensor_transfer"):
        trained(make_config, view, **settings)
