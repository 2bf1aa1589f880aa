import importlib.metadata
import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from lerobot.utils.import_utils import register_third_party_plugins
from loaded_memory import peak_bytes, write_sparse
from safetensors.torch import load_file, save_file
from torch import nn
from transformers import AutoTokenizer

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy, weights
from lerobot_policy_pi05_uniforce.checkpoint import check_sensors
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import REMOVED, TinySettings
from lerobot_policy_pi05_uniforce.model_card import model_card
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import (
    FOLDER,
    SAVED,
    VOCABULARY,
    UniforceTokenizerProcessorStep,
)
from lerobot_policy_pi05_uniforce.weights import fill
from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.file_hashes import write_hashes
from uniforce_vtla.markers import MARKER_IMAGES
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead, ForceRegressor, HeadConfig


@pytest.fixture
def checkpoint(make_policy, tmp_path):
    make_policy().save_pretrained(tmp_path)
    return tmp_path


def change_settings(checkpoint, **touch):
    """Change stored settings of touch, hashes and all."""
    path = checkpoint / "config.json"
    config = json.loads(path.read_text())
    config["touch"] |= touch
    path.write_text(json.dumps(config))
    write_hashes(checkpoint)


def stored_touch(checkpoint):
    return json.loads((checkpoint / "config.json").read_text())["touch"]


def test_lerobot_finds_the_policy_by_name():
    register_third_party_plugins()
    assert "pi05_uniforce" in PreTrainedConfig.get_known_choices()
    assert get_policy_class("pi05_uniforce") is PI05UniforcePolicy
    name = importlib.metadata.distribution("lerobot_policy_pi05_uniforce").metadata["Name"]
    assert name == "lerobot_policy_pi05_uniforce"  # a hyphen would hide it from LeRobot


def test_every_tensor_comes_back_without_the_tokenizers_file(make_policy, make_batch, tmp_path):
    policy = make_policy()
    policy.config.touch.tokenizer_path = "/gone"
    policy.save_pretrained(tmp_path)
    loaded = PI05UniforcePolicy.from_pretrained(tmp_path)
    assert (
        not loaded.training and loaded.config.tokenizer_hash == policy.config.tokenizer_hash != ""
    )
    saved, came = policy.state_dict(), loaded.state_dict()
    assert saved.keys() == came.keys() and sum("tactile_encoder" in k for k in saved) > 10
    assert all(torch.equal(saved[k], came[k]) for k in saved)
    batch, start = make_batch(policy), torch.randn(2, 16, 8)
    assert torch.equal(*(p.predict_action_chunk(batch, noise=start) for p in (policy, loaded)))


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
    tensors = load_file(checkpoint / "model.safetensors")
    damage(tensors)
    save_file(tensors, checkpoint / "model.safetensors")
    with pytest.raises(CheckpointError, match=said):
        PI05UniforcePolicy.from_pretrained(checkpoint)


def test_truncated_or_missing_files_raise(checkpoint):
    weights = checkpoint / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-100])
    with pytest.raises(CheckpointError, match="cut or damaged"):
        PI05UniforcePolicy.from_pretrained(checkpoint)
    weights.unlink()
    with pytest.raises(CheckpointError, match=r"model\.safetensors"):
        PI05UniforcePolicy.from_pretrained(checkpoint)
    (checkpoint / "config.json").write_text("{")
    with pytest.raises(CheckpointError, match="JSON"):
        PI05UniforcePolicy.from_pretrained(checkpoint)
    with pytest.raises(CheckpointError, match=r"config\.json"):
        PI05UniforcePolicy.from_pretrained(checkpoint / "nowhere")


def test_swap_runs_the_same_checkpoint(make_policy, make_batch, tmp_path):
    make_policy(touch__slots={"touch0": "right"}).save_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--swap=touch0:left"])
    policy = PI05UniforcePolicy.from_pretrained(tmp_path, config=config)
    batch = make_batch(policy)
    chunk = policy.predict_action_chunk(
        {k: v for k, v in batch.items() if "tactile_right" not in k}
    )
    assert chunk.shape == (2, 16, 5) and torch.isfinite(chunk).all()


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
    ("path", "value"), [("touch.site", "suffix"), ("action.previous_steps", 4)]
)
def test_what_was_removed_is_refused_and_its_names_are_tolerated(checkpoint, path, value):
    file = checkpoint / "config.json"
    stored = json.loads(file.read_text())
    group, _, name = path.partition(".")
    assert stored[group][name] == REMOVED[path]  # as in older checkpoints, and it loads
    del stored[group][name]
    file.write_text(json.dumps(stored))
    write_hashes(checkpoint)
    PI05UniforcePolicy.from_pretrained(checkpoint)
    stored[group][name] = value
    file.write_text(json.dumps(stored))
    write_hashes(checkpoint)
    with pytest.raises(CheckpointError, match=f"{path} in .* expected .*{value}.*304b337e"):
        PI05UniforcePolicy.from_pretrained(checkpoint)


def test_other_sensors_must_be_asked_for(make_config):
    trained = {"touch0": "tactip", "touch1": "gelsight"}
    mounted = {"left": "uskin", "right": "tactip"}
    with pytest.raises(CheckpointError, match="left_sensor=uskin"):
        check_sensors(make_config(touch__trained_sensors=trained), mounted)
    notes = check_sensors(make_config(touch__trained_sensors=trained, left_sensor="uskin"), mounted)
    assert len(notes) == 1 and "gelsight" in notes[0] and "uskin" in notes[0]
    same = {"left": "gelsight", "right": "tactip"}
    assert check_sensors(make_config(touch__trained_sensors=trained), same) == []
    slots = {"touch__slots": {"touch0": "right"}, "touch__trained_sensors": {"touch0": "tactip"}}
    one = make_config(**slots, swap="touch0:left")
    assert len(check_sensors(one, mounted)) == 1


def test_sensors_of_the_training_view_are_stored(make_config, tmp_path):
    sensors = {"left": ["gelsight", "uskin"], "right": ["tactip"]}
    meta = SimpleNamespace(root=tmp_path, sensors=sensors, total_episodes=9, used_episodes=4)
    (tmp_path / "uniforce_view.json").write_text("{}")
    config = make_config(touch__input="wrench")
    PI05UniforcePolicy(config, dataset_meta=meta)
    assert config.touch.trained_sensors == {"touch0": "tactip", "touch1": "gelsight+uskin"}
    assert config.trained_on["episodes"] == "4"
    assert check_sensors(config, {"left": "uskin", "right": "tactip"}) == []
    with pytest.raises(CheckpointError, match="right_sensor=uskin"):
        check_sensors(config, {"left": "uskin", "right": "uskin"})


def test_the_packages_tokenizer_is_stored_once(make_policy, make_batch, tmp_path):
    """A checkpoint then holds its hash; one that still has the weights loads as well."""
    policy = make_policy(touch__tokenizer_path=None)
    policy.save_pretrained(tmp_path)
    stored = load_file(tmp_path / "model.safetensors")
    assert not any("tactile_encoder" in name for name in stored)
    batch = make_batch(policy)
    for extra in ({}, {k: v for k, v in policy.state_dict().items() if "tactile_encoder" in k}):
        save_file(stored | extra, tmp_path / "model.safetensors")
        loaded = PI05UniforcePolicy.from_pretrained(tmp_path)
        assert torch.equal(loaded.predict_action_chunk(batch), policy.predict_action_chunk(batch))


def test_a_checkpoint_of_0_1_0_is_named_so(tmp_path):
    (tmp_path / "config.json").write_text(
        json.dumps({"type": "pi05_uniforce", "touch_input": "latent"})
    )
    with pytest.raises(CheckpointError, match=r"version 0\.1\.0"):
        PI05UniforcePolicy.from_pretrained(tmp_path)


def test_tensors_lie_where_new_ones_would(tmp_path):
    """A checkpoint's own layout would show in the last bits of what a policy answers."""
    layer = nn.Sequential(nn.Linear(3, 5), nn.Linear(5, 1))
    save_file(
        {name: value.clone() for name, value in layer.state_dict().items()},
        tmp_path / "w.safetensors",
    )
    fill(layer, tmp_path / "w.safetensors")
    assert all(weight.data_ptr() % 64 == 0 for weight in layer.parameters())


@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="peak memory is read from Linux's /proc"
)
def test_a_checkpoint_is_never_held_twice(tmp_path):
    """200 MB of weights in a process of their own: memory grows by the weights and little else."""
    wide = {"tiny": TinySettings(width=1024, depth=3, mlp_dim=2048)}
    size = write_sparse(tmp_path, size="tiny", image_resolution=(28, 28), **wide)
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


def test_every_saved_policy_has_a_card(make_policy, tmp_path):
    policy = make_policy()
    policy.save_pretrained(tmp_path)
    assert policy.config.tokenizer_hash in (tmp_path / "README.md").read_text()
    assert "tactile" in policy.generate_model_card("x/y", "pi05_uniforce", None, None).data.tags


def test_scores_must_be_scores():
    with pytest.raises(ContractError, match="arms"):
        model_card(PI05UniforceConfig(size="tiny", device="cpu"), scores={"level": "easy"})


def test_a_tokenizer_of_ones_own_moves_with_the_preprocessor(tmp_path):
    shutil.copytree(FOLDER, tmp_path, dirs_exist_ok=True)
    packaged = AutoTokenizer.from_pretrained(FOLDER)
    assert len(packaged) < VOCABULARY
    own = UniforceTokenizerProcessorStep(tokenizer_name=str(tmp_path), max_length=16)
    assert own.get_config()["tokenizer_name"] == SAVED
    assert own.save_artifacts(tmp_path / "none") == {}, "LeRobot's main would save a folder"
    again = UniforceTokenizerProcessorStep(**own.get_config())
    with pytest.raises(CheckpointError, match="text tokenizer"):
        again._tokenize_text("wipe")
    again.load_state_dict(own.state_dict())
    assert torch.equal(*(step._tokenize_text("wipe it")["input_ids"] for step in (own, again)))
    assert (
        again.get_config() == own.get_config()
        and again.state_dict().keys() == own.state_dict().keys()
    )
    packaged = UniforceTokenizerProcessorStep(max_length=16)
    name = packaged.get_config()["tokenizer_name"]
    # an installation may move
    assert packaged.state_dict() == {} and name != SAVED and not name.startswith("/")


def test_only_who_loads_chooses_how_files_are_verified(make_policy, tmp_path):
    policy = make_policy(verify="quick")
    policy.save_pretrained(tmp_path)
    assert policy.config.verify == "quick"
    stored = json.loads((tmp_path / "config.json").read_text())
    assert stored["verify"] == "full"
    write_hashes(tmp_path)
    (tmp_path / "config.json").write_text(json.dumps(stored | {"verify": "off"}))
    with pytest.raises(CheckpointError, match=r"got config\.json: "):
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
    with pytest.raises(CheckpointError, match=r"config\.json: 2 bytes"):
        weights.check_files("somebody/policy", "full", None, False)


def test_a_policy_of_other_marker_images_is_refused(checkpoint):
    assert stored_touch(checkpoint)["marker_images"] == MARKER_IMAGES
    change_settings(checkpoint, marker_images=1)
    with pytest.raises(CheckpointError, match="marker images"):
        PI05UniforcePolicy.from_pretrained(checkpoint)


@pytest.mark.parametrize(
    ("stored", "said"), [("", "head_hash"), ("0" * 64, "force head of tactip")]
)
def test_a_policy_of_another_force_head_is_refused(make_policy, tmp_path, stored, said):
    """Its newtons would be in another scale, and nothing else would show it."""
    make_policy(touch__input="newtons").save_pretrained(tmp_path)
    assert stored_touch(tmp_path)["head_hash"] == ForceHead.from_pretrained("tactip").hash
    change_settings(tmp_path, head_hash=stored)
    with pytest.raises(CheckpointError, match=said):
        PI05UniforcePolicy.from_pretrained(tmp_path)


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
    batch = make_batch(policy)
    loaded = PI05UniforcePolicy.from_pretrained(tmp_path / "policy")
    assert torch.equal(loaded.predict_action_chunk(batch), policy.predict_action_chunk(batch))

    weights = tmp_path / "policy" / "model.safetensors"
    changed = load_file(weights) | {"model.tactile_encoder.head.force_scale": torch.full((3,), 2.0)}
    save_file(changed, weights)
    write_hashes(tmp_path / "policy")
    with pytest.raises(CheckpointError, match="force head hash"):
        PI05UniforcePolicy.from_pretrained(tmp_path / "policy")

    (tmp_path / "gone").rename(path.parent)
    change_settings(tmp_path / "policy", head_sizes=None)
    # a path in a checkpoint is never followed
    with pytest.raises(CheckpointError, match="Fit a head"):
        PI05UniforcePolicy.from_pretrained(tmp_path / "policy")


def test_a_tokenizer_without_a_head_of_its_own_is_refused(make_policy, tokenizer_path, tmp_path):
    path = str(Tokenizer.from_pretrained(tokenizer_path).save(tmp_path / "tokenizer"))
    with pytest.raises(CheckpointError, match="uniforce pretrain"):
        make_policy(touch__input="newtons", touch__tokenizer_path=path)
    ForceHead(ForceRegressor(HeadConfig()), "tactip", "another").save(
        tmp_path / "force_head_tactip"
    )
    with pytest.raises(CheckpointError, match="Fit a head"):
        make_policy(touch__input="newtons", touch__tokenizer_path=path)


def test_text_that_stays_is_tokenized_once(monkeypatch):
    step = UniforceTokenizerProcessorStep(max_length=16)
    calls = []
    real = step.input_tokenizer
    monkeypatch.setattr(
        step, "input_tokenizer", lambda text, **how: calls.append(text) or real(text, **how)
    )
    first = step._tokenize_text(["wipe"])
    again = step._tokenize_text(["wipe"])
    assert torch.equal(first["input_ids"], again["input_ids"]) and len(calls) == 1
    assert not torch.equal(step._tokenize_text(["lift"])["input_ids"], first["input_ids"])
    assert torch.equal(step._tokenize_text(["wipe"])["input_ids"], first["input_ids"])
    assert calls == [["wipe"], ["lift"], ["wipe"]]
