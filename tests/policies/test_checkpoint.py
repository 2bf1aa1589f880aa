import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from loaded_memory import peak_bytes, write_sparse
from safetensors.torch import load_file, save_file
from torch import nn

from benchmarks.trust.injuries import cut, edit_json
from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy, weights
from lerobot_policy_pi05_uniforce.checkpoint import check_sensors
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import REMOVED, TinySettings
from lerobot_policy_pi05_uniforce.model_card import model_card
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import (
    FOLDER,
    PACKAGED,
    SAVED,
    VOCABULARY,
    UniforceTokenizerProcessorStep,
)
from lerobot_policy_pi05_uniforce.weights import fill
from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.file_hashes import write_hashes
from uniforce_vtla.keys import VIEW_MARKER
from uniforce_vtla.markers import MARKER_IMAGES
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead, ForceRegressor, HeadConfig


@pytest.fixture
def checkpoint(policy, tmp_path):
    policy.save_pretrained(tmp_path)
    return tmp_path


def load(folder):
    return PI05UniforcePolicy.from_pretrained(folder)


def change_tensors(checkpoint, change):
    """Change stored weights, hashes and all."""
    tensors = load_file(checkpoint / "model.safetensors")
    change(tensors)
    save_file(tensors, checkpoint / "model.safetensors")
    write_hashes(checkpoint)


def change_settings(checkpoint, change):
    """Change stored settings, hashes and all."""
    edit_json(checkpoint / "config.json", change)
    write_hashes(checkpoint)


def stored_settings(checkpoint):
    return json.loads((checkpoint / "config.json").read_text())


def same_actions(one, other, batch):
    noise = torch.randn(2, 16, 8)
    chunk = one.predict_action_chunk(batch, noise=noise)
    return torch.equal(chunk, other.predict_action_chunk(batch, noise=noise))


def test_every_tensor_comes_back_without_the_tokenizers_file(make_policy, make_batch, tmp_path):
    policy = make_policy(touch__start_at_base=True)
    policy.config.touch.tokenizer_path = "/gone"
    policy.save_pretrained(tmp_path)
    loaded = load(tmp_path)
    assert not loaded.training
    assert loaded.config.tokenizer_hash == policy.config.tokenizer_hash != ""
    saved, came = policy.state_dict(), loaded.state_dict()
    torch.testing.assert_close(came, saved, rtol=0, atol=0)
    assert "model.touch_gate.gate" in saved and sum("tactile_encoder" in k for k in saved) > 10
    assert same_actions(loaded, policy, make_batch(policy))


def changed_tokenizer(tensors):
    name = next(k for k in tensors if "tactile_encoder" in k and k.endswith("weight"))
    tensors[name] = tensors[name] + 1e-3


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (
            lambda t: t.pop("model.force_tokens.proj.0.weight"),
            "missing.*force_tokens.proj.0.weight",
        ),
        (lambda t: t.update({"model.surplus": torch.zeros(3)}), "unexpected.*model.surplus"),
        (
            lambda t: t.update({"model.action_in_proj.bias": torch.zeros(7)}),
            "misshapen.*action_in_proj.bias",
        ),
        (
            lambda t: t["model.action_in_proj.bias"].fill_(torch.nan),
            r"action_in_proj.bias of .*NaN or inf",
        ),
        (changed_tokenizer, "tokenizer hash"),
    ],
)
def test_a_tensor_that_does_not_fit_raises(checkpoint, damage, said):
    change_tensors(checkpoint, damage)
    with pytest.raises(CheckpointError, match=said):
        load(checkpoint)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda folder: cut(folder / "model.safetensors"), "cut or damaged"),
        (lambda folder: (folder / "model.safetensors").unlink(), r"model\.safetensors"),
        (lambda folder: (folder / "config.json").write_text("{"), "JSON"),
        (lambda folder: (folder / "config.json").unlink(), r"config\.json"),
    ],
)
def test_truncated_or_missing_files_raise(checkpoint, damage, said):
    damage(checkpoint)
    with pytest.raises(CheckpointError, match=said):
        load(checkpoint)


@pytest.mark.parametrize(
    ("name", "value"),
    [("slots", {"touch0": "left"}), ("tokenizer", {"hash": "beef"}), ("input", "wrench")],
)
def test_touch_settings_must_be_the_checkpoints_own(checkpoint, name, value):
    config = PreTrainedConfig.from_pretrained(checkpoint)
    setattr(config.touch, name, value)
    with pytest.raises(CheckpointError, match=f"touch settings.*'{name}'") as error:
        PI05UniforcePolicy.from_pretrained(checkpoint, config=config)
    others = {"slots", "tokenizer", "input"} - {name}
    # only what differs is named
    assert not any(f"'{other}'" in str(error.value) for other in others)


@pytest.mark.parametrize(
    ("group", "name", "value"), [("touch", "site", "suffix"), ("action", "previous_steps", 4)]
)
def test_what_was_removed_is_refused_and_its_names_are_tolerated(checkpoint, group, name, value):
    path = f"{group}.{name}"
    # as in older checkpoints, and it loads
    assert stored_settings(checkpoint)[group][name] == REMOVED[path]
    change_settings(checkpoint, lambda config: config[group].pop(name))
    load(checkpoint)
    change_settings(checkpoint, lambda config: config[group].update({name: value}))
    with pytest.raises(CheckpointError, match=f"{path} in .* expected .*{value}.*304b337e"):
        load(checkpoint)


def test_other_sensors_must_be_asked_for(make_config):
    mounted = {"left": "uskin", "right": "tactip"}
    trained = {"touch__trained_sensors": {"touch0": "tactip", "touch1": "gelsight"}}
    with pytest.raises(CheckpointError, match="left_sensor=uskin"):
        check_sensors(make_config(**trained), mounted)
    (note,) = check_sensors(make_config(**trained, left_sensor="uskin"), mounted)
    assert "gelsight" in note and "uskin" in note
    one = make_config(**trained, touch__slots={"touch0": "right"}, swap="touch0:left")
    assert len(check_sensors(one, mounted)) == 1


def test_sensors_of_the_training_view_are_stored(make_config, tmp_path):
    sensors = {"left": ["gelsight", "uskin"], "right": ["tactip"]}
    meta = SimpleNamespace(root=tmp_path, sensors=sensors, total_episodes=9, used_episodes=4)
    (tmp_path / VIEW_MARKER).write_text("{}")
    # of an earlier training, whose weights this one starts from
    config = make_config(touch__input="wrench", touch__trained_sensors={"touch0": "uskin"})
    PI05UniforcePolicy(config, dataset_meta=meta)
    assert config.touch.trained_sensors == {"touch0": "tactip", "touch1": "gelsight+uskin"}
    assert config.trained_on["episodes"] == "4"
    for left in ("gelsight", "uskin"):
        assert check_sensors(config, {"left": left, "right": "tactip"}) == []
    with pytest.raises(CheckpointError, match="right_sensor=uskin"):
        check_sensors(config, {"left": "uskin", "right": "uskin"})


def test_a_fresh_policy_takes_no_random_weights_for_a_tokenizer_it_names(make_config):
    config = make_config()
    own = {**Tokenizer.from_pretrained("nano").facts(), "hash": "0" * 64}
    config.touch.tokenizer = (
        own  # as a train_config.json of a training with a tokenizer of one's own
    )
    with pytest.raises(CheckpointError, match="tokenizer_path"):
        PI05UniforcePolicy(config)


def test_the_packages_tokenizer_is_stored_once(make_policy, make_batch, tmp_path):
    """A checkpoint then holds its hash; one that still has the weights loads as well."""
    policy = make_policy(touch__tokenizer_path=None)
    policy.save_pretrained(tmp_path)
    assert not any("tactile_encoder" in name for name in load_file(tmp_path / "model.safetensors"))
    batch = make_batch(policy)
    assert same_actions(load(tmp_path), policy, batch)
    change_tensors(tmp_path, lambda stored: stored.update(policy.state_dict()))
    assert same_actions(load(tmp_path), policy, batch)


def test_a_checkpoint_of_0_1_0_is_named_so(tmp_path):
    (tmp_path / "config.json").write_text('{"type": "pi05_uniforce", "touch_input": "latent"}')
    with pytest.raises(CheckpointError, match=r"version 0\.1\.0"):
        load(tmp_path)


def test_tensors_lie_where_new_ones_would(tmp_path):
    """A checkpoint's own layout would show in the last bits of what a policy answers."""
    layer = nn.Sequential(nn.Linear(3, 5), nn.Linear(5, 1))
    save_file(layer.state_dict(), tmp_path / "w.safetensors")
    fill(layer, tmp_path / "w.safetensors")
    assert all(weight.data_ptr() % 64 == 0 for weight in layer.parameters())


@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="peak memory is read from Linux's /proc"
)
@pytest.mark.thorough
def test_a_checkpoint_is_never_held_twice(tmp_path):
    """200 MB of weights in a process of their own: memory grows by the weights and little else."""
    wide = TinySettings(width=1024, depth=3, mlp_dim=2048)
    size = write_sparse(tmp_path, size="tiny", image_resolution=(28, 28), tiny=wide)
    assert size > 150e6
    # 20 MB: buffers of a forward
    assert 0.9 * size < peak_bytes(tmp_path) < 1.15 * size + 20e6


def test_base_passes_the_gemma_terms_on_and_tiny_is_free():
    base = model_card(PI05UniforceConfig(size="base", device="cpu"))
    assert base.data.license == "gemma" and "ai.google.dev/gemma/terms" in base.text
    assert base.data.base_model == "lerobot/pi05_base"
    tiny = model_card(PI05UniforceConfig(size="tiny", device="cpu"))
    assert tiny.data.license == "apache-2.0" and "gemma/terms" not in tiny.text
    assert "Not scored" in tiny.text and "right finger" in tiny.text


def test_every_saved_policy_has_a_card(policy, checkpoint):
    assert policy.config.tokenizer_hash in (checkpoint / "README.md").read_text()
    assert "tactile" in policy.generate_model_card("x/y", "pi05_uniforce", None, None).data.tags


def test_scores_must_be_scores():
    with pytest.raises(ContractError, match="arms"):
        model_card(PI05UniforceConfig(size="tiny", device="cpu"), scores={"level": "easy"})


def test_a_tokenizer_of_ones_own_moves_with_the_preprocessor(tmp_path):
    shutil.copytree(FOLDER, tmp_path, dirs_exist_ok=True)
    own = UniforceTokenizerProcessorStep(tokenizer_name=str(tmp_path), max_length=16)
    assert own.get_config()["tokenizer_name"] == SAVED
    assert own.save_artifacts(tmp_path / "none") == {}, "LeRobot's main would save a folder"
    again = UniforceTokenizerProcessorStep(**own.get_config())
    with pytest.raises(CheckpointError, match="text tokenizer"):
        again._tokenize_text("wipe")
    again.load_state_dict(own.state_dict())
    assert torch.equal(*(step._tokenize_text("wipe it")["input_ids"] for step in (own, again)))
    assert again.get_config() == own.get_config()
    assert again.state_dict().keys() == own.state_dict().keys()


def test_the_packaged_tokenizer_is_stored_by_a_name_that_is_no_path():
    """An installation may move."""
    packaged = UniforceTokenizerProcessorStep(max_length=16)
    assert len(packaged.input_tokenizer) < VOCABULARY
    assert packaged.state_dict() == {}
    assert packaged.get_config()["tokenizer_name"] == PACKAGED


def test_only_who_loads_chooses_how_files_are_verified(make_policy, tmp_path):
    policy = make_policy(verify="quick")
    policy.save_pretrained(tmp_path)
    assert policy.config.verify == "quick" and stored_settings(tmp_path)["verify"] == "full"
    write_hashes(tmp_path)
    edit_json(tmp_path / "config.json", lambda config: config.update(verify="off"))
    with pytest.raises(CheckpointError, match=r"got config\.json: "):
        load(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--verify=off"])
    with pytest.raises(CheckpointError, match="Only who loads"):
        PI05UniforcePolicy.from_pretrained(tmp_path, config=config)
    policy.save_pretrained(tmp_path)  # over it: hashes of the files before are gone
    load(tmp_path)


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
    with pytest.raises(CheckpointError, match=r"config\.json: 2 bytes"):
        weights.check_files("somebody/policy", "full", None, False)


@pytest.mark.parametrize(
    ("name", "stored", "said"),
    [
        ("marker_images", 1, "marker images"),
        ("head_hash", "", "head_hash"),
        ("head_hash", "0" * 64, "force head of tactip"),
    ],
)
def test_a_policy_of_other_marker_images_or_another_force_head_is_refused(
    make_policy, tmp_path, name, stored, said
):
    """Its newtons would be in another scale, and nothing else would show it."""
    make_policy(touch__input="newtons").save_pretrained(tmp_path)
    touch = stored_settings(tmp_path)["touch"]
    assert touch["marker_images"] == MARKER_IMAGES
    assert touch["head_hash"] == ForceHead.from_pretrained("tactip").hash
    change_settings(tmp_path, lambda config: config["touch"].update({name: stored}))
    with pytest.raises(CheckpointError, match=said):
        load(tmp_path)


def test_a_head_of_ones_own_travels_with_its_tokenizer(
    make_policy, make_batch, tokenizer_path, tmp_path
):
    """Only the package's tokenizers have heads in the package."""
    tokenizer = Tokenizer.from_pretrained(tokenizer_path)
    path = tokenizer.save(tmp_path / "made" / "tokenizer")
    head = ForceHead(ForceRegressor(HeadConfig(hidden=4, mlp=8)), "tactip", tokenizer.hash)
    head.save(path.parent / "force_head_tactip")
    policy = make_policy(touch__input="newtons", touch__tokenizer_path=str(path))
    assert not policy.train().model.tactile_encoder.head.training
    policy.eval().save_pretrained(tmp_path / "policy")
    path.parent.rename(tmp_path / "gone")
    assert same_actions(load(tmp_path / "policy"), policy, make_batch(policy))

    name = "model.tactile_encoder.head.force_scale"
    change_tensors(tmp_path / "policy", lambda stored: stored[name].mul_(2))
    with pytest.raises(CheckpointError, match="force head hash"):
        load(tmp_path / "policy")

    (tmp_path / "gone").rename(path.parent)
    change_settings(tmp_path / "policy", lambda config: config["touch"].update(head_sizes=None))
    # a path in a checkpoint is never followed
    with pytest.raises(CheckpointError, match="Fit a head"):
        load(tmp_path / "policy")


def test_a_tokenizer_without_a_head_of_its_own_is_refused(make_policy, tokenizer_path, tmp_path):
    path = str(Tokenizer.from_pretrained(tokenizer_path).save(tmp_path / "tokenizer"))
    with pytest.raises(CheckpointError, match="uniforce pretrain"):
        make_policy(touch__input="newtons", touch__tokenizer_path=path)
    head = ForceHead(ForceRegressor(HeadConfig()), "tactip", "another")
    head.save(tmp_path / "force_head_tactip")
    with pytest.raises(CheckpointError, match="Fit a head"):
        make_policy(touch__input="newtons", touch__tokenizer_path=path)


def test_text_that_stays_is_tokenized_once(monkeypatch):
    step = UniforceTokenizerProcessorStep(max_length=16)
    tokenizer = mock.Mock(side_effect=step.input_tokenizer)
    monkeypatch.setattr(step, "input_tokenizer", tokenizer)
    tokens = [step._tokenize_text([word])["input_ids"] for word in ("wipe", "wipe", "lift", "wipe")]
    assert torch.equal(tokens[0], tokens[1]) and torch.equal(tokens[0], tokens[3])
    assert not torch.equal(tokens[2], tokens[0])
    assert tokenizer.call_count == 3
