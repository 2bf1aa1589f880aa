import importlib.util
import json
import logging
import os
import shutil
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.datasets import factory
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.scripts import lerobot_eval, lerobot_train
from safetensors.torch import load_file, save_file

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import SPAN_FLOOR
from uniforce_cli import lerobot_training, share
from uniforce_cli.compat import patched_trainer
from uniforce_vtla.errors import ContractError, DatasetError
from uniforce_vtla.keys import VIEW_MARKER

AXES = ["x.pos", "y.pos", "z.pos", "yaw.pos", "width.pos"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Two episodes of ten frames with cameras, state, cached latents and absolute targets.

    The hand never turns.
    """
    root = tmp_path_factory.mktemp("data") / "wipe"
    image = {"dtype": "image", "shape": (28, 28, 3), "names": ["height", "width", "channels"]}
    five = {"dtype": "float32", "shape": (5,), "names": AXES}
    latent = {"dtype": "float32", "shape": (96,), "names": [f"z{i}" for i in range(96)]}
    features = {"observation.images.front": image, "observation.images.wrist": image}
    features |= {"observation.state": five, "action": five, "observation.latent.touch0": latent}
    made = LeRobotDataset.create(
        "local/wipe", fps=30, features=features, root=root, use_videos=False
    )
    random = np.random.default_rng(0)
    for _ in range(2):
        for _ in range(10):
            frame = {
                k: random.integers(0, 255, (28, 28, 3), dtype=np.uint8) for k in list(features)[:2]
            }
            frame |= {
                k: random.random(5, dtype=np.float32) for k in ("observation.state", "action")
            }
            frame["observation.state"][3] = 0.5
            frame["observation.latent.touch0"] = (7 + 4 * random.standard_normal(96)).astype(
                np.float32
            )
            made.add_frame({**frame, "task": "wipe the ink off the board"})
        made.save_episode()
    made.finalize()
    return root


def latents_in(dataset):
    """Return (20, 96) latents of the dataset, with a mean far from zero."""
    rows = pq.read_table(dataset / "data", columns=["observation.latent.touch0"]).to_pydict()
    return np.array(rows["observation.latent.touch0"], dtype=np.float32)


LAST = Path("checkpoints/last/pretrained_model")
NORMALIZERS = (
    "policy_preprocessor_step_3_normalizer_processor",
    "policy_postprocessor_step_0_unnormalizer_processor",
)
SMALL = "tiny.width=64 tiny.depth=2 tiny.mlp_dim=32 image_resolution=[28,28]"


def policy_settings(tokenizer_path):
    model = [f"policy.{entry}" for entry in SMALL.split()]
    touch = [
        f"policy.touch.tokenizer_path={tokenizer_path}",
        "policy.touch.slots={touch0: right}",
        "policy.touch.input=latent",
    ]
    return ["policy=pi05_uniforce", "policy.size=tiny", "policy.device=cpu", *model, *touch]


def run_settings(dataset, out, steps=2):
    data = [
        "dataset.repo_id=local/wipe",
        f"dataset.root={dataset}",
        f"output_dir={out}",
        "num_workers=0",
    ]
    often = (
        f"steps={steps} batch_size={max(2, steps // 5)} log_freq=1 save_freq={max(2, steps // 2)}"
    )
    return [*data, *often.split(), "env_eval_freq=0"]


def test_lerobot_trains_saves_and_resumes(dataset, tokenizer_path, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    out = tmp_path / "run"
    lerobot_training.train(
        [*policy_settings(tokenizer_path), *run_settings(dataset, out, steps=20)]
    )
    last = out / "checkpoints" / "last" / "pretrained_model"
    early = load_file(out / "checkpoints" / "000010" / "pretrained_model" / "model.safetensors")
    late = load_file(last / "model.safetensors")
    moved = {k for k in early if not torch.equal(early[k], late[k])}
    assert any("force_tokens.proj" in k for k in moved) and any("vision_tower" in k for k in moved)
    assert not any("tactile_encoder" in k for k in moved)
    hashed = json.loads((last / "hashes.json").read_text()).keys()
    assert hashed == {path.name for path in last.iterdir()} - {"hashes.json"}
    assert {"train_config.json", "policy_postprocessor.json"} < hashed
    policy = PI05UniforcePolicy.from_pretrained(last)
    tokens = policy.model.force_tokens
    latents = torch.from_numpy(latents_in(dataset)).reshape(20, 16, 6)
    standardised = (latents - tokens.input_mean) / tokens.input_scale
    assert standardised.mean(dim=0).abs().max() < 1e-4
    assert standardised.square().mean() == pytest.approx(1.0, rel=0.01)
    assert policy.config.push_to_hub is False

    lerobot_training.train(["resume=true", f"config_path={last / 'train_config.json'}", "steps=24"])
    assert (
        json.loads((out / "checkpoints/last/training_state/training_step.json").read_text())["step"]
        == 24
    )

    # from a checkpoint, on new data statistics: LeRobot rebuilds the normaliser
    tuned = tmp_path / "tuned"
    lerobot_training.train(
        [f"policy.path={last}", "policy.device=cpu", *run_settings(dataset, tuned)]
    )
    last = tuned / "checkpoints/last/pretrained_model"
    saved = load_file(next(last.glob("*normalizer_processor.safetensors")))
    assert "observation.state.q99" in saved


def stock_train(settings, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(sys, "argv", ["lerobot-train", *lerobot_training.to_lerobot(settings)])
        lerobot_train.main()


def test_our_trainer_makes_lerobots_weights_and_leaves_lerobot_as_it_was(
    dataset, tokenizer_path, tmp_path, monkeypatch
):
    """From nothing, then from that checkpoint: LeRobot gives the normaliser the data's statistics."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    start = policy_settings(tokenizer_path)
    tuned = [f"policy.path={tmp_path / 'begun/stock' / LAST}", "policy.device=cpu"]
    for name, policy in (("begun", start), ("tuned", tuned)):
        run = {kind: tmp_path / name / kind for kind in ("ours", "stock")}
        stock_train([*policy, *run_settings(dataset, run["stock"])], monkeypatch)
        before = lerobots_state()
        lerobot_training.train([*policy, *run_settings(dataset, run["ours"])])
        assert lerobots_state() == before
        for file in ("model", *NORMALIZERS):
            ours = load_file(run["ours"] / LAST / f"{file}.safetensors")
            stock = load_file(run["stock"] / LAST / f"{file}.safetensors")
            assert ours.keys() == stock.keys()
            assert not [key for key in ours if not torch.equal(ours[key], stock[key])]
        normalizer = load_file(run["stock"] / LAST / f"{NORMALIZERS[0]}.safetensors")
        span = normalizer["observation.state.q99"] - normalizer["observation.state.q01"]
        assert span[3] == pytest.approx(SPAN_FLOOR[3]), "a still axis can't explode at rollout"


def lerobots_state():
    """Return what a training could leave changed."""
    return [
        factory.make_dataset,
        lerobot_train.save_checkpoint,
        list(sys.argv),
        logging.root.manager.disable,
    ]


def test_a_training_view_is_read_through_its_own_reader(tmp_path, monkeypatch):
    module = ModuleType("uniforce_datasets.training_view")
    module.make_training_dataset = lambda cfg, stock, verify: ("view", stock)
    monkeypatch.setitem(sys.modules, "uniforce_datasets.training_view", module)
    stock = factory.make_dataset
    cfg = SimpleNamespace(dataset=SimpleNamespace(root=tmp_path, eval_split=0.0))
    (tmp_path / VIEW_MARKER).write_text("{}")
    with patched_trainer():
        assert factory.make_dataset(cfg) == ("view", stock)
        cfg.dataset.eval_split = 0.1
        with pytest.raises(ContractError, match="eval_split"):
            factory.make_dataset(cfg)
    assert factory.make_dataset is stock


def test_other_datasets_are_checked_and_stay_with_lerobot(dataset, tmp_path, monkeypatch):
    root = Path(shutil.copytree(dataset, tmp_path / "copy"))
    monkeypatch.setattr(factory, "make_dataset", lambda cfg: SimpleNamespace(root=root))
    plain = {
        "streaming": False,
        "episodes": None,
        "image_transforms": SimpleNamespace(enable=False),
    }
    local = SimpleNamespace(root=root, repo_id="local/wipe", **plain)
    shared = SimpleNamespace(root=None, repo_id="somebody/wipe", **plain)
    with patched_trainer():
        assert factory.make_dataset(SimpleNamespace(dataset=local)).root == root
        next((root / "data").rglob("*.parquet")).unlink()
        for given in (local, shared):
            with pytest.raises(DatasetError, match="parquet"):
                factory.make_dataset(SimpleNamespace(dataset=given))
    with patched_trainer("off"):
        assert factory.make_dataset(SimpleNamespace(dataset=local)).root == root


def test_command_line_becomes_lerobots():
    given = ["policy=pi05_uniforce", "steps=5", "--policy.size=tiny", "wandb.enable=true"]
    flags = lerobot_training.to_lerobot(given)
    given = [
        "--policy.type=pi05_uniforce",
        "--steps=5",
        "--policy.size=tiny",
        "--wandb.enable=true",
    ]
    assert flags == [*given, "--policy.push_to_hub=false"]
    assert {"--num_workers=0", "--save_freq=1000"} <= set(
        lerobot_training.to_lerobot([*given, "policy.device=cpu"])
    )
    assert lerobot_training.take_verify(["steps=5", "verify=off"]) == ("off", ["steps=5"])
    assert lerobot_training.take_verify(["steps=5"]) == ("", ["steps=5"])
    resumed = lerobot_training.to_lerobot(["resume=true", "config_path=a=b.json"])
    assert resumed == ["--resume=true", "--config_path=a=b.json"]


# π0.5's own settings in a small network
AS_BASE = [
    "policy.touch.start_at_base=true",
    "policy.action.form=absolute",
    "policy.action.objective=flow",
    "policy.sampler.noise_scale=1",
    "policy.action.stop_outside_demos=never",  # two steps of training say nothing of the scene
]


@pytest.mark.skipif(
    importlib.util.find_spec("peft") is None, reason="peft isn't installed (an extra)"
)
def test_ten_steps_of_lora_are_saved_loaded_merged_and_rolled_out(
    dataset, tokenizer_path, tmp_path, monkeypatch
):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    started = [*policy_settings(tokenizer_path), *AS_BASE]
    lerobot_training.train([*started, *run_settings(dataset, tmp_path / "start")])
    start = tmp_path / "start" / LAST
    more = [f"policy.path={start}", "policy.device=cpu", "--peft.method_type=LORA", "--peft.r=2"]
    lerobot_training.train([*more, *run_settings(dataset, tmp_path / "lora", steps=10)])
    trained = tmp_path / "lora" / LAST
    assert (trained / "adapter_model.safetensors").exists()
    assert not (trained / "model.safetensors").exists()
    shared = tmp_path / "shared"
    assert share.main([f"checkpoint={trained}", f"out={shared}"]) == 0
    merged = load_file(shared / "model.safetensors")
    before = load_file(start / "model.safetensors")
    assert merged.keys() == before.keys()
    moved = {name for name in merged if not torch.equal(merged[name], before[name])}
    assert any("gemma_expert" in name for name in moved)
    assert "model.touch_gate.gate" in moved
    assert not any("vision_tower" in name or "tactile_encoder" in name for name in moved)
    assert not PI05UniforcePolicy.from_pretrained(shared).config.use_peft
    words = [f"--policy.path={shared}", "--policy.device=cpu", f"--output_dir={tmp_path / 'eval'}"]
    words += ["--env.type=uniforce_wiping", "--env.episode_length=4", "--eval.n_episodes=1"]
    words += ["--eval.batch_size=1", "--eval.use_async_envs=false"]
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", *words])
    lerobot_eval.main()
    (scene,) = json.loads((tmp_path / "eval" / "eval_info.json").read_text())["per_task"]
    assert len(scene["metrics"]["successes"]) == 1


def test_two_processes_train_without_a_search_for_unused_parameters(
    dataset, tokenizer_path, tmp_path, run_to_the_end
):
    """The second step would stop with an error, had any weight of any process been left without a gradient."""
    launch = "torch.distributed.run --standalone --nproc-per-node=2 --module uniforce_cli.train"
    call = [sys.executable, "-m", *launch.split()]
    call += [*policy_settings(tokenizer_path), "policy.augment.touch_dropout=0.5"]
    call += run_settings(dataset, tmp_path / "run")
    quiet = {"HF_HUB_OFFLINE": "1", "ACCELERATE_USE_CPU": "true", "OMP_NUM_THREADS": "1"}
    quiet["GLOO_SOCKET_IFNAME"] = "lo"  # the address of this machine's name may lead nowhere
    said = run_to_the_end(call, os.environ | quiet, tmp_path / "said", seconds=200)
    assert (tmp_path / "run/checkpoints/last/pretrained_model/model.safetensors").exists()
    assert "Effective batch size: 2 x 2" in said


def test_the_process_group_outlives_the_trainer(monkeypatch):
    """PyTorch deadlocks where the trainer's last frame is the last to hold the group: here it is not."""
    monkeypatch.setattr(lerobot_training, "KEPT_GROUPS", [])
    monkeypatch.setenv("GLOO_SOCKET_IFNAME", "lo")
    accelerator = lerobot_training.TrainingAccelerator(
        PI05UniforceConfig(size="tiny", device="cpu")
    )
    assert accelerator.ddp_handler.find_unused_parameters is False
    dist = torch.distributed
    dist.init_process_group("gloo", store=dist.HashStore(), rank=0, world_size=1)
    group = torch.nn.parallel.DistributedDataParallel(torch.nn.Linear(2, 2)).process_group
    accelerator.end_training()
    assert [group] == lerobot_training.KEPT_GROUPS and not dist.is_initialized()


PROGRAM = Path(__file__).with_name("sharded_program.py")


def test_a_sharded_step_is_the_whole_policys_step(
    make_policy, make_batch, tmp_path, run_to_the_end
):
    still = {f"augment__{name}": 0.0 for name in ("touch_dropout", "camera_variation")}
    policy = make_policy(**still, sampler__noise_scale=0.0, action__objective="regression")
    policy.save_pretrained(tmp_path / "begun")
    batch = {
        k: v.contiguous()
        for k, v in make_batch(policy, 4, actions=True).items()
        if torch.is_tensor(v)
    }
    save_file(batch, tmp_path / "batch.safetensors")
    launch = "torch.distributed.run --standalone --nproc-per-node=2"
    files = [tmp_path / "begun", tmp_path / "batch.safetensors", tmp_path / "sharded"]
    env = os.environ | {"OMP_NUM_THREADS": "1", "GLOO_SOCKET_IFNAME": "lo"}
    call = [sys.executable, "-m", *launch.split(), str(PROGRAM), *map(str, files)]
    run_to_the_end(call, env, tmp_path / "said", 200)
    whole = PI05UniforcePolicy.from_pretrained(tmp_path / "begun").train()
    optimizer = torch.optim.SGD([p for p in whole.parameters() if p.requires_grad], lr=1.0)
    losses = [whole({k: v.chunk(2)[i] for k, v in batch.items()})[0] for i in range(2)]
    torch.stack(losses).mean().backward()
    optimizer.step()
    before = load_file(tmp_path / "begun" / "model.safetensors")
    found = load_file(tmp_path / "sharded" / "model.safetensors")
    assert found.keys() == before.keys()
    moved = 0
    for name, weight in whole.state_dict().items():
        if name in found:
            torch.testing.assert_close(found[name], weight, rtol=1e-4, atol=1e-6)
            moved += not torch.equal(found[name], before[name])
    assert moved > 10
    PI05UniforcePolicy.from_pretrained(tmp_path / "sharded")
