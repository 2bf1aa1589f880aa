import importlib.util
import json
import logging
import os
import shutil
import sys
from contextlib import suppress
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import psutil
import pytest
import torch
from lerobot.datasets import factory
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.scripts import lerobot_eval, lerobot_train
from safetensors.torch import load_file, save_file

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import SPAN_FLOOR
from uniforce_cli import lerobot_training, share
from uniforce_cli.compat import training_views
from uniforce_vtla.errors import ContractError, DatasetError
from uniforce_vtla.keys import ACTION, AXES, STATE, VIEW_MARKER, latent_key

LATENTS = 7 + 4 * np.random.default_rng(0).standard_normal((20, 96)).astype(np.float32)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Two episodes of ten frames with cameras, state, cached latents and absolute targets.

    The hand never turns.
    """
    root = tmp_path_factory.mktemp("data") / "wipe"
    image = {"dtype": "image", "shape": (28, 28, 3), "names": ["height", "width", "channels"]}
    five = {"dtype": "float32", "shape": (5,), "names": list(AXES)}
    latent = {"dtype": "float32", "shape": (96,), "names": [f"z{i}" for i in range(96)]}
    features = {"observation.images.front": image, "observation.images.wrist": image}
    features |= {STATE: five, ACTION: five, latent_key("touch0"): latent}
    made = LeRobotDataset.create("local/wipe", 30, features, root, use_videos=False)
    random = np.random.default_rng(0)
    for episode in LATENTS.reshape(2, 10, 96):
        for latents in episode:
            frame = {"task": "wipe the ink off the board"}
            for name, feature in features.items():
                frame[name] = random.random(feature["shape"], dtype=np.float32)
            frame[STATE][3] = 0.5
            made.add_frame(frame | {latent_key("touch0"): latents})
        made.save_episode()
    made.finalize()
    return root


LAST = Path("checkpoints/last/pretrained_model")
NORMALIZERS = (
    "policy_preprocessor_step_3_normalizer_processor",
    "policy_postprocessor_step_0_unnormalizer_processor",
)
SMALL = "size=tiny device=cpu tiny.width=64 tiny.depth=2 tiny.mlp_dim=32 image_resolution=[28,28]"


@pytest.fixture
def new(tokenizer_path, monkeypatch):
    """Settings of a small new policy that feels cached latents."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    one_finger = "touch.slots={touch0: right}"
    touch = ["touch.input=latent", one_finger, f"touch.tokenizer_path={tokenizer_path}"]
    return ["policy=pi05_uniforce", *(f"policy.{word}" for word in (*SMALL.split(), *touch))]


def trained(folder):
    """Settings of a policy that goes on from a run's last checkpoint."""
    return [f"policy.path={folder / LAST}", "policy.device=cpu"]


def run_settings(dataset, out, steps=2):
    data = [f"dataset.root={dataset}", f"output_dir={out}"]
    often = f"batch_size={max(2, steps // 5)} log_freq=1 save_freq={max(2, steps // 2)}"
    more = f"dataset.repo_id=local/wipe num_workers=0 env_eval_freq=0 steps={steps}"
    return [*data, *often.split(), *more.split()]


def test_lerobot_trains_saves_and_resumes(dataset, new, tmp_path):
    out = tmp_path / "run"
    lerobot_training.train([*new, *run_settings(dataset, out, steps=20)])
    last = out / LAST
    early = load_file(out / "checkpoints" / "000010" / "pretrained_model" / "model.safetensors")
    late = load_file(last / "model.safetensors")
    moved = {k for k in early if not torch.equal(early[k], late[k])}
    assert any("force_tokens.proj" in k for k in moved) and any("vision_tower" in k for k in moved)
    assert not any("tactile_encoder" in k for k in moved)
    hashed = json.loads((last / "hashes.json").read_text()).keys()
    assert hashed == {path.name for path in last.iterdir()} - {"hashes.json"}
    assert {"train_config.json", "policy_postprocessor.json"} < hashed
    policy = PI05UniforcePolicy.from_pretrained(last)
    assert policy.config.push_to_hub is False
    tokens = policy.model.force_tokens
    latents = torch.from_numpy(LATENTS).reshape(20, 16, 6)
    standardised = (latents - tokens.input_mean) / tokens.input_scale
    assert standardised.mean(dim=0).abs().max() < 1e-4
    assert standardised.square().mean() == pytest.approx(1.0, rel=0.01)

    lerobot_training.train(["resume=true", f"config_path={last / 'train_config.json'}", "steps=24"])
    state = (last / "../training_state/training_step.json").read_text()
    assert json.loads(state)["step"] == 24


def stock_train(settings, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(sys, "argv", ["lerobot-train", *lerobot_training.to_lerobot(settings)])
        lerobot_train.main()


def test_our_trainer_makes_lerobots_weights_and_leaves_lerobot_as_it_was(
    dataset, new, tmp_path, monkeypatch
):
    """From nothing, then from that checkpoint: LeRobot gives the normaliser the data's
    statistics."""
    for name, policy in (("begun", new), ("tuned", trained(tmp_path / "begun/stock"))):
        run = {kind: tmp_path / name / kind for kind in ("ours", "stock")}
        stock_train([*policy, *run_settings(dataset, run["stock"])], monkeypatch)
        before = lerobots_state()
        lerobot_training.train([*policy, *run_settings(dataset, run["ours"])])
        assert lerobots_state() == before
        for file in ("model", *NORMALIZERS):
            ours = load_file(run["ours"] / LAST / f"{file}.safetensors")
            stock = load_file(run["stock"] / LAST / f"{file}.safetensors")
            torch.testing.assert_close(ours, stock, rtol=0, atol=0)
        normalizer = load_file(run["stock"] / LAST / f"{NORMALIZERS[0]}.safetensors")
        span = normalizer["observation.state.q99"] - normalizer["observation.state.q01"]
        assert span[3] == pytest.approx(SPAN_FLOOR[3]), "a still axis can't explode at rollout"


def lerobots_state():
    """Return what a training could leave changed."""
    patched = [factory.make_dataset, lerobot_train.save_checkpoint]
    return [*patched, list(sys.argv), logging.root.manager.disable]


def test_a_training_view_is_read_through_its_own_reader(tmp_path, monkeypatch):
    module = ModuleType("uniforce_datasets.training_view")
    module.make_training_dataset = lambda cfg, stock, verify: ("view", stock)
    monkeypatch.setitem(sys.modules, "uniforce_datasets.training_view", module)
    stock = factory.make_dataset
    cfg = SimpleNamespace(dataset=SimpleNamespace(root=tmp_path, eval_split=0.0))
    (tmp_path / VIEW_MARKER).write_text("{}")
    with training_views():
        assert factory.make_dataset(cfg) == ("view", stock)
        cfg.dataset.eval_split = 0.1
        with pytest.raises(ContractError, match="eval_split"):
            factory.make_dataset(cfg)
    assert factory.make_dataset is stock


def test_other_datasets_are_checked_and_stay_with_lerobot(dataset, tmp_path, monkeypatch):
    root = Path(shutil.copytree(dataset, tmp_path / "copy"))
    monkeypatch.setattr(factory, "make_dataset", lambda cfg: SimpleNamespace(root=root))
    plain = {"streaming": False, "episodes": None}
    plain["image_transforms"] = SimpleNamespace(enable=False)
    local, shared = (
        SimpleNamespace(dataset=SimpleNamespace(root=where, repo_id=repo_id, **plain))
        for where, repo_id in ((root, "local/wipe"), (None, "somebody/wipe"))
    )
    with training_views():
        assert factory.make_dataset(local).root == root
        next((root / "data").rglob("*.parquet")).unlink()
        for given in (local, shared):
            with pytest.raises(DatasetError, match="parquet"):
                factory.make_dataset(given)
    with training_views("off"):
        assert factory.make_dataset(local).root == root


def test_command_line_becomes_lerobots():
    given = ["policy=pi05_uniforce", "steps=5", "--policy.device=cuda", "wandb.enable=true"]
    flags = lerobot_training.to_lerobot(given)
    given = [
        "--policy.type=pi05_uniforce",
        "--steps=5",
        "--policy.device=cuda",
        "--wandb.enable=true",
    ]
    assert flags == [*given, "--policy.push_to_hub=false"]
    on_cpu = lerobot_training.to_lerobot(["policy=pi05_uniforce", "policy.device=cpu"])
    assert {"--num_workers=0", "--save_freq=1000"} <= set(on_cpu)
    assert lerobot_training.take_verify(["steps=5", "verify=off"]) == ("off", ["steps=5"])
    assert lerobot_training.take_verify(["steps=5"]) == ("", ["steps=5"])
    assert lerobot_training.take_verify(["steps=5", "--verify=full"]) == ("full", ["steps=5"])
    begun = lerobot_training.to_lerobot([*given, "resume=false"])
    assert "--policy.push_to_hub=false" in begun
    resumed = lerobot_training.to_lerobot(["resume=true", "config_path=a=b.json"])
    assert resumed == ["--resume=true", "--config_path=a=b.json"]


@pytest.mark.parametrize("accelerator", [False, True])
def test_a_machine_without_an_accelerator_saves_often(accelerator, monkeypatch):
    monkeypatch.setattr(torch.accelerator, "is_available", lambda: accelerator)
    flags = lerobot_training.to_lerobot(["policy=pi05_uniforce", "steps=5"])
    assert ("--save_freq=1000" in flags) is not accelerator


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
@pytest.mark.thorough
def test_ten_steps_of_lora_are_saved_loaded_merged_and_rolled_out(
    dataset, new, tmp_path, monkeypatch
):
    begun = tmp_path / "begun"
    lerobot_training.train([*new, *AS_BASE, *run_settings(dataset, begun)])
    lora = ["--peft.method_type=LORA", "--peft.r=2"]
    run = run_settings(dataset, tmp_path / "lora", steps=10)
    lerobot_training.train([*trained(begun), *lora, *run])
    adapted = tmp_path / "lora" / LAST
    assert (adapted / "adapter_model.safetensors").exists()
    assert not (adapted / "model.safetensors").exists()
    shared = tmp_path / "shared"
    assert share.main([f"checkpoint={adapted}", f"out={shared}"]) == 0
    merged = load_file(shared / "model.safetensors")
    before = load_file(begun / LAST / "model.safetensors")
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


def run_twice(folder, *words):
    """Run a program in two processes to its end and return what it said; one that hangs or fails
    shows it."""
    launch = "torch.distributed.run --standalone --nproc-per-node=2"
    call = [sys.executable, "-m", *launch.split(), *map(str, words)]
    # the address of this machine's name may lead nowhere
    quiet = {"ACCELERATE_USE_CPU": "true", "OMP_NUM_THREADS": "1", "GLOO_SOCKET_IFNAME": "lo"}
    with (folder / "said").open("w") as out:
        program = psutil.Popen(call, env=os.environ | quiet, stdout=out, stderr=out)
        try:
            code = program.wait(200)
        except psutil.TimeoutExpired:
            code = None
        finally:
            with suppress(psutil.NoSuchProcess):
                for process in [*program.children(recursive=True), program]:
                    process.kill()
    said = (folder / "said").read_text()
    assert code == 0, f"exit {code} (None: still running): {said[-4000:]}"
    return said


@pytest.mark.thorough
def test_two_processes_train_without_a_search_for_unused_parameters(dataset, new, tmp_path):
    """The second step would stop with an error, had any weight of any process been left without a
    gradient."""
    words = [*new, "policy.augment.touch_dropout=0.5", *run_settings(dataset, tmp_path / "run")]
    said = run_twice(tmp_path, "--module", "uniforce_cli.train", *words)
    assert (tmp_path / "run" / LAST / "model.safetensors").exists()
    assert "Effective batch size: 2 x 2" in said


def test_the_process_group_outlives_the_trainer(monkeypatch):
    """PyTorch deadlocks where the trainer's last frame is the last to hold the group: here it is
    not."""
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


@pytest.mark.thorough
def test_a_sharded_step_is_the_whole_policys_step(make_policy, make_batch, tmp_path):
    still = {"augment__touch_dropout": 0.0, "augment__camera_variation": 0.0}
    policy = make_policy(**still)
    begun, sharded, file = (tmp_path / name for name in ("begun", "sharded", "batch.safetensors"))
    policy.save_pretrained(begun)
    made = make_batch(policy, 4)
    batch = {key: value.contiguous() for key, value in made.items() if torch.is_tensor(value)}
    save_file(batch, file)
    run_twice(tmp_path, Path(__file__).with_name("sharded_program.py"), begun, file, sharded)
    whole = PI05UniforcePolicy.from_pretrained(begun).train()
    optimizer = torch.optim.SGD(whole.parameters(), lr=1.0)
    whole(batch)[0].backward()
    optimizer.step()
    before = load_file(begun / "model.safetensors")
    found = load_file(sharded / "model.safetensors")
    wanted = {name: weight for name, weight in whole.state_dict().items() if name in before}
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-6)
    assert sum(not torch.equal(found[name], before[name]) for name in before) > 10
    PI05UniforcePolicy.from_pretrained(sharded)


def test_a_dataset_without_a_finger_that_the_policy_feels_with_is_refused(new, dataset, tmp_path):
    both = [word.replace("{touch0: right}", "{touch0: right, touch1: left}") for word in new]
    with pytest.raises(DatasetError, match="touch1, left finger: expected"):
        lerobot_training.train([*both, *run_settings(dataset, tmp_path / "run", steps=2)])


def test_a_run_in_a_folder_that_is_there_says_how_to_go_on(new, dataset, tmp_path):
    with pytest.raises(ContractError, match=r"output_dir: expected .*resume=true"):
        lerobot_training.train([*new, *run_settings(dataset, tmp_path, steps=2)])
