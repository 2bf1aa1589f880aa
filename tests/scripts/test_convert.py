"""A published π0.5 becomes a pi05_uniforce: names of the real size, and a whole conversion in
miniature."""

import shutil

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.pi05 import modeling_pi05 as stock
from lerobot.policies.pi05.configuration_pi05 import PI05Config
from policy_samples import small_config
from safetensors.torch import load_file, save_file

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import TouchSettings
from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch
from lerobot_policy_pi05_uniforce.weights import EMBEDDING, FRESH, HEADS, no_weights, own_names
from uniforce_cli import lerobot_training
from uniforce_cli.convert import main
from uniforce_datasets.synthetic import record_synthetic
from uniforce_datasets.training_view import build_view
from uniforce_vtla.tokenizer import Tokenizer


def test_every_tensor_of_the_real_size_finds_its_place():
    """LeRobot's own 4 B network against ours, both without memory: same names, same shapes, two
    heads less."""
    with no_weights():
        theirs = stock.PI05Pytorch(PI05Config(device="cpu"))
    touch = TouchSettings(input="wrench")
    config = PI05UniforceConfig(size="base", device="cpu", dtype="bfloat16", touch=touch)
    config.input_features = {"observation.state": PolicyFeature(FeatureType.STATE, (5,))}
    ours = PI05UniforcePytorch(config, empty=True)
    published = {f"model.{name}": tuple(t.shape) for name, t in theirs.state_dict().items()}
    names = own_names(published)
    assert set(published) - set(names) == set(HEADS)
    wanted = {f"model.{n}": tuple(t.shape) for n, t in ours.state_dict().items()}
    # training starts at the base
    assert any(name.startswith("model.touch_gate.") for name in wanted)
    wanted = {name: shape for name, shape in wanted.items() if not name.startswith(FRESH)}
    assert {names[name]: published[name] for name in names} == wanted
    assert sum(p.numel() for p in ours.parameters()) > 3.3e9
    dtypes = {p.dtype for n, p in ours.named_parameters() if "gemma_expert.model.layers.0.mlp" in n}
    assert dtypes == {torch.bfloat16}


def test_a_tied_embedding_is_found_and_openpis_names_are_understood():
    wanted = {
        HEADS[0].removeprefix("model."): EMBEDDING,
        "action_time_mlp_in.weight": "model.time_mlp_in.weight",
        "strange": "model.strange",  # no known tensor: the loader will name it
    }
    assert own_names(list(wanted)) == wanted


@pytest.fixture(scope="module")
def view(tmp_path_factory):
    folder = tmp_path_factory.mktemp("convert")
    root = record_synthetic(folder / "data", 1, 6)
    nano = Tokenizer.from_pretrained("nano")
    return build_view(root, folder / "view", image_side=28, tokenizer=nano, keep=bool)


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """A policy without touch, both language heads in its file as LeRobot writes them."""
    folder = tmp_path_factory.mktemp("published")
    config = small_config(touch=TouchSettings(input="none"))
    PI05UniforcePolicy(config).save_pretrained(folder)
    tensors = load_file(folder / "model.safetensors")
    save_file(tensors | {head: torch.zeros(4, 4) for head in HEADS}, folder / "model.safetensors")
    return folder


def test_a_conversion_keeps_every_weight_and_trains_on(published, view, tmp_path):
    out = tmp_path / "converted"
    assert main([f"source={published}", f"view={view}", f"out={out}", "touch_input=wrench"]) == 0
    policy = PI05UniforcePolicy.from_pretrained(out)
    before = load_file(published / "model.safetensors")
    after = policy.state_dict()
    for name in before.keys() - {*HEADS}:
        assert torch.equal(after[name], before[name]), name
    assert any("force_tokens" in name for name in after.keys() - before.keys())
    data = ["dataset.repo_id=local/view", f"dataset.root={view}", f"output_dir={tmp_path / 'run'}"]
    run = ["steps=2", "batch_size=2", "num_workers=0", "save_freq=2", "policy.device=cpu"]
    lerobot_training.train([f"policy.path={out}", *data, *run])
    last = tmp_path / "run" / "checkpoints" / "last" / "pretrained_model"
    assert (last / "model.safetensors").exists()


@pytest.mark.parametrize("name", ["model.action_in_proj.weight", "model.strange"])
def test_missing_and_strange_tensors_are_named(name, published, view, tmp_path, refuses):
    tensors = load_file(published / "model.safetensors")
    if tensors.pop(name, None) is None:
        tensors[name] = torch.zeros(1)
    shutil.copy(published / "config.json", tmp_path)
    save_file(tensors, tmp_path / "model.safetensors")
    words = [f"source={tmp_path}", f"view={view}", f"out={tmp_path / 'out'}", "touch_input=wrench"]
    refuses(main, words, name)
    assert not (tmp_path / "out").exists()


def test_nothing_is_converted_into_a_folder_with_files(published, view, tmp_path, refuses):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "adapter_config.json").write_text("{}")
    words = [f"source={published}", f"view={view}", f"out={tmp_path / 'out'}"]
    refuses(main, words, "empty folder")


def test_another_policy_is_refused(view, tmp_path, refuses):
    (tmp_path / "config.json").write_text('{"type": "act"}')
    refuses(main, [f"source={tmp_path}", f"view={view}", f"out={tmp_path / 'out'}"], "pi05")
