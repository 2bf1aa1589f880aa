from __future__ import annotations

import importlib.metadata
import json
from types import SimpleNamespace

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins
from safetensors.torch import load_file, save_file

from lerobot_policy_pi05_uniforce import (
    PI05UniforceConfig,
    PI05UniforcePolicy,
    make_pi05_uniforce_pre_post_processors,
    weights,
)
from lerobot_policy_pi05_uniforce.compatibility import check_sensors
from uniforce_vtla.errors import CheckpointError, DatasetError
from uniforce_vtla.file_hashes import write_hashes


@pytest.fixture
def checkpoint(make_policy, tmp_path):
    make_policy().save_pretrained(tmp_path)
    return tmp_path


def tensors_of(policy):
    return {k: v.clone() for k, v in policy.state_dict().items()}


def test_lerobot_finds_the_policy_by_name():
    register_third_party_plugins()
    assert "pi05_uniforce" in PreTrainedConfig.get_known_choices()
    assert get_policy_class("pi05_uniforce") is PI05UniforcePolicy
    name = importlib.metadata.distribution("lerobot_policy_pi05_uniforce").metadata["Name"]
    assert name == "lerobot_policy_pi05_uniforce"  # a hyphen would hide it from LeRobot


def test_every_tensor_comes_back(make_policy, tmp_path):
    policy = make_policy()
    policy.save_pretrained(tmp_path)
    loaded = PI05UniforcePolicy.from_pretrained(tmp_path)
    assert not loaded.training
    saved, came = tensors_of(policy), tensors_of(loaded)
    assert saved.keys() == came.keys()
    assert all(torch.equal(saved[k], came[k]) for k in saved)
    assert sum("tactile_encoder" in k for k in saved) > 10


def test_loading_needs_no_tokenizer_file(make_config, make_policy, make_batch, tmp_path):
    policy = make_policy()
    policy.config.tokenizer_path = "/gone"
    policy.save_pretrained(tmp_path)
    loaded = PI05UniforcePolicy.from_pretrained(tmp_path)
    assert loaded.config.tokenizer_hash == policy.config.tokenizer_hash != ""
    torch.manual_seed(1)
    batch = make_batch(policy)
    start = torch.randn(2, 16, 8)
    assert torch.equal(
        policy.predict_action_chunk(batch, noise=start), loaded.predict_action_chunk(batch, noise=start)
    )


def damage_missing(tensors):
    del tensors["model.force_tokens.proj.0.weight"]


def damage_extra(tensors):
    tensors["model.surplus"] = torch.zeros(3)


def damage_shape(tensors):
    tensors["model.action_in_proj.bias"] = torch.zeros(7)


def damage_tokenizer(tensors):
    name = next(k for k in tensors if "tactile_encoder" in k and k.endswith("weight"))
    tensors[name] = tensors[name] + 1e-3


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (damage_missing, "missing.*force_tokens.proj.0.weight"),
        (damage_extra, "unexpected.*model.surplus"),
        (damage_shape, "misshapen.*action_in_proj.bias"),
        (damage_tokenizer, "tokenizer hash"),
    ],
)
def test_a_tensor_that_does_not_fit_raises(checkpoint, damage, said):
    path = checkpoint / "model.safetensors"
    tensors = load_file(path)
    damage(tensors)
    save_file(tensors, path)
    with pytest.raises(CheckpointError, match=said):
        PI05UniforcePolicy.from_pretrained(checkpoint)


def test_a_number_that_is_not_finite_is_named(checkpoint):
    path = checkpoint / "model.safetensors"
    tensors = load_file(path)
    tensors["model.action_in_proj.bias"][0] = torch.nan
    save_file(tensors, path)
    with pytest.raises(CheckpointError, match=r"model.action_in_proj.bias of .*NaN or inf"):
        PI05UniforcePolicy.from_pretrained(checkpoint)


def test_only_who_loads_chooses_how_files_are_verified(make_policy, tmp_path):
    policy = make_policy(verify="quick")
    policy.save_pretrained(tmp_path)
    assert policy.config.verify == "quick"
    stored = json.loads((tmp_path / "config.json").read_text())
    assert stored["verify"] == "full"
    write_hashes(tmp_path)
    (tmp_path / "config.json").write_text(json.dumps(stored | {"verify": "off"}))
    with pytest.raises(CheckpointError, match=r"config\.json of"):
        PI05UniforcePolicy.from_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--verify=off"])
    with pytest.raises(CheckpointError, match="Only who loads"):
        PI05UniforcePolicy.from_pretrained(tmp_path, config=config)
    policy.save_pretrained(tmp_path)  # over it: hashes of the files before are gone
    PI05UniforcePolicy.from_pretrained(tmp_path)


def test_files_of_a_hub_repository_are_fetched_and_verified(checkpoint, monkeypatch):
    write_hashes(checkpoint)
    fetched = []

    def download(source, name, **_):
        fetched.append(name)
        if not (checkpoint / name).is_file():
            raise OSError(name)
        return str(checkpoint / name)

    monkeypatch.setattr(weights, "hf_hub_download", download)
    weights.check_files("somebody/policy", "full", None, False)
    assert {"hashes.json", "model.safetensors", "README.md"} <= set(fetched)
    (checkpoint / "config.json").write_text("{}")
    with pytest.raises(CheckpointError, match=r"config\.json of 2 bytes"):
        weights.check_files("somebody/policy", "full", None, False)


def test_truncated_or_missing_files_raise(checkpoint):
    path = checkpoint / "model.safetensors"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(CheckpointError, match="cut or damaged"):
        PI05UniforcePolicy.from_pretrained(checkpoint)
    path.unlink()
    with pytest.raises(CheckpointError, match=r"model\.safetensors"):
        PI05UniforcePolicy.from_pretrained(checkpoint)
    (checkpoint / "config.json").write_text("{")
    with pytest.raises(CheckpointError, match="JSON"):
        PI05UniforcePolicy.from_pretrained(checkpoint)
    with pytest.raises(CheckpointError, match=r"config\.json"):
        PI05UniforcePolicy.from_pretrained(checkpoint / "nowhere")


def test_swap_runs_the_same_checkpoint(make_policy, make_batch, tmp_path):
    make_policy(touch_slots={"touch0": "right"}).save_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--swap=touch0:left"])
    policy = PI05UniforcePolicy.from_pretrained(tmp_path, config=config)
    batch = make_batch(policy)
    chunk = policy.predict_action_chunk({k: v for k, v in batch.items() if "tactile_right" not in k})
    assert chunk.shape == (2, 16, 5) and torch.isfinite(chunk).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("touch_slots", {"touch0": "left"}),
        ("tokenizer_hash", "beef"),
        ("latent_grid", 2),
        ("token_site", "suffix"),
    ],
)
def test_touch_settings_must_be_the_checkpoints_own(checkpoint, name, value):
    config = PreTrainedConfig.from_pretrained(checkpoint)
    setattr(config, name, value)
    said = "slots" if name == "touch_slots" else name
    with pytest.raises(CheckpointError, match=f"touch settings.*'{said}'") as error:
        PI05UniforcePolicy.from_pretrained(checkpoint, config=config)
    others = {"slots", "tokenizer_hash", "latent_grid", "token_site"} - {said}
    assert not any(f"'{other}'" in str(error.value) for other in others)  # only what differs is named


def test_other_sensors_must_be_asked_for(make_config):
    trained = {"touch0": "tactip", "touch1": "gelsight"}
    mounted = {"left": "uskin", "right": "tactip"}
    with pytest.raises(CheckpointError, match="left_sensor=uskin"):
        check_sensors(make_config(trained_sensors=trained), mounted)
    notes = check_sensors(make_config(trained_sensors=trained, left_sensor="uskin"), mounted)
    assert len(notes) == 1 and "gelsight" in notes[0] and "uskin" in notes[0]
    assert check_sensors(make_config(trained_sensors=trained), {"left": "gelsight", "right": "tactip"}) == []
    one = make_config(
        touch_slots={"touch0": "right"}, trained_sensors={"touch0": "tactip"}, swap="touch0:left"
    )
    assert len(check_sensors(one, mounted)) == 1


def test_a_view_made_by_another_tokenizer_is_refused(make_config, tmp_path):
    class Meta:
        root = tmp_path

    (tmp_path / "uniforce_view.json").write_text(json.dumps({"tokenizer_hash": "other"}))
    with pytest.raises(DatasetError, match="other"):
        PI05UniforcePolicy(make_config(), dataset_meta=Meta())


def test_sensors_of_the_training_view_are_stored(make_config, tmp_path):
    sensors = {"left": ["gelsight", "uskin"], "right": ["tactip"]}
    meta = SimpleNamespace(root=tmp_path, sensors=sensors, total_episodes=9, used_episodes=4)
    (tmp_path / "uniforce_view.json").write_text("{}")
    config = make_config(touch_input="wrench")
    PI05UniforcePolicy(config, dataset_meta=meta)
    assert config.trained_sensors == {"touch0": "tactip", "touch1": "gelsight+uskin"}
    assert config.trained_on["episodes"] == "4"
    assert check_sensors(config, {"left": "uskin", "right": "tactip"}) == []
    with pytest.raises(CheckpointError, match="right_sensor=uskin"):
        check_sensors(config, {"left": "uskin", "right": "uskin"})


def test_processors_survive_a_round_trip(make_policy, make_batch, stats, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    policy = make_policy()
    before, after = make_pi05_uniforce_pre_post_processors(policy.config, stats)
    before.save_pretrained(tmp_path), after.save_pretrained(tmp_path)
    stored = json.loads((tmp_path / "policy_preprocessor.json").read_text())
    text = next(s for s in stored["steps"] if s["registry_name"] == "uniforce_tokenizer_processor")
    assert not text["config"]["tokenizer_name"].startswith("/")  # a moved installation must still load
    again, _ = make_pre_post_processors(policy.config, pretrained_path=str(tmp_path))
    raw = {"observation.state": torch.tensor([[0.5, 0.0, 0.1, 0.0, 0.04]]), "task": ["wipe"]}
    one, two = before(dict(raw)), again(dict(raw))
    assert all(torch.equal(one[k], two[k]) for k in one if isinstance(one[k], torch.Tensor))


def test_config_survives_a_round_trip(make_config, tmp_path):
    config = make_config(swap="touch0:left", left_sensor="uskin")
    config._save_pretrained(tmp_path)
    again = PreTrainedConfig.from_pretrained(tmp_path)
    assert isinstance(again, PI05UniforceConfig)
    assert again == config


def test_auto_size_is_tiny_on_a_cpu():
    assert PI05UniforceConfig(device="cpu").size == "tiny"


def test_lora_trains_the_new_modules(make_policy):
    targets = make_policy()._get_default_peft_targets()
    assert {"force_tokens", "state_token"} <= set(targets["modules_to_save"])
