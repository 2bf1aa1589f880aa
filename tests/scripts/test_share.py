"""A shared policy: everything another person needs, and nothing of the machine it was made on."""

import json
import os
import shutil
import subprocess
import sys
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
import torch
from huggingface_hub import DatasetCard, ModelCard
from huggingface_hub.errors import OfflineModeIsEnabled
from huggingface_hub.utils import filter_repo_objects
from policy_samples import small_config

from benchmarks.trust.injuries import edit_json
from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy
from lerobot_policy_pi05_uniforce import make_pi05_uniforce_pre_post_processors as make_processors
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import TouchSettings
from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint
from lerobot_policy_pi05_uniforce.model_card import model_card
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import FOLDER
from uniforce_cli import share
from uniforce_cli.score import content_of
from uniforce_datasets.cards import read_card
from uniforce_datasets.lossless import check_dataset, rehash
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.synthetic import FPS, record_synthetic, synthetic_frame
from uniforce_vtla.tokenizer import Tokenizer

ELSEWHERE = """
import sys, torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins
torch.set_num_threads(1)
register_third_party_plugins()
config = PreTrainedConfig.from_pretrained(sys.argv[1])
policy = get_policy_class(config.type).from_pretrained(sys.argv[1], config=config)
before, after = make_pre_post_processors(config, pretrained_path=sys.argv[1])
torch.save(after(policy.select_action(before(torch.load("raw.pt")))), "action.pt")
"""
# two checkpoints took turns: the first one's scenes are C, s or r, the other one failed every grasp
SCORES = {"level": "easy", "arms": {"V+T": {"n": 20, "clean": 16, "success": 17}}}


def raw_observation():
    generator = torch.Generator().manual_seed(0)
    raw = {"task": ["wipe the ink off the board"]}
    for name in ("front", "wrist"):
        raw[f"observation.images.{name}"] = torch.rand(1, 3, 28, 28, generator=generator)
    for suffix in ("", "_ref"):
        markers = torch.rand(1, 1, 48, 64, generator=generator) > 0.9
        raw[f"observation.images.tactile_right{suffix}"] = markers.float().expand(-1, 3, -1, -1)
    raw["observation.state"] = torch.full((1, 5), 0.1)
    return raw


@pytest.fixture
def trained(tmp_path, tiny):
    """A checkpoint as the trainer leaves it, its tokenizers in folders of their own; action.pt is
    what it answers."""
    torch.manual_seed(0)
    shutil.copytree(FOLDER, tmp_path / "words")
    Tokenizer.random(tiny).save(tmp_path / "tactile")
    touch = TouchSettings(slots={"touch0": "right"}, tokenizer_path=str(tmp_path / "tactile"))
    config = small_config(touch=touch, text_tokenizer_name=str(tmp_path / "words"))
    one = {"q01": np.zeros(5), "q99": np.ones(5), "min": np.zeros(5), "max": np.ones(5)}
    stats = {"observation.state": dict(one), "action": dict(one)}
    meta = SimpleNamespace(
        repo_id="somebody/wipe", total_episodes=7, total_frames=70, fps=30, root=tmp_path
    )
    policy = PI05UniforcePolicy(config, dataset_stats=None, dataset_meta=meta).eval()
    before, after = make_processors(config, stats)
    for part in (policy, before, after):
        part.save_pretrained(tmp_path / "trained")
    (tmp_path / "trained" / "train_config.json").write_text(
        '{"steps": 40, "output_dir": "/machine/only"}'
    )
    torch.save(after(policy.select_action(before(raw_observation()))), tmp_path / "action.pt")
    return tmp_path / "trained"


@pytest.fixture
def shared(tmp_path):
    return tmp_path / "shared"


@pytest.fixture
def share_trained(trained, shared):
    """Return a function: share the checkpoint into ``shared`` with more words → exit code."""
    return lambda more: share.main([f"checkpoint={trained}", f"out={shared}", *more])


@pytest.fixture
def scores(tmp_path):
    (tmp_path / "wiping.json").write_text(json.dumps(SCORES))
    return tmp_path / "wiping.json"


@pytest.mark.thorough
def test_another_machine_gets_the_same_action(share_trained, scores, shared, tmp_path):
    assert share_trained([f"scores={scores}"]) == 0
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    moved = shared.rename(elsewhere / "moved")
    for gone in ("words", "tactile", "trained"):
        shutil.rmtree(tmp_path / gone)
    torch.save(raw_observation(), elsewhere / "raw.pt")
    env = os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(elsewhere / "no_cache")}
    call = [sys.executable, "-c", ELSEWHERE, str(moved)]
    subprocess.run(call, cwd=elsewhere, env=env, check=True, timeout=240, capture_output=True)
    assert torch.equal(torch.load(elsewhere / "action.pt"), torch.load(tmp_path / "action.pt"))
    for file in moved.glob("*.json"):
        assert str(tmp_path) not in file.read_text() and "/machine/only" not in file.read_text()
    card = (moved / "README.md").read_text()
    assert "somebody/wipe" in card and "| V+T | 16/20 | 17/20 |" in card and "steps: 40" in card


def test_a_card_does_not_carry_another_policys_scores(trained, share_trained, scores, refuses):
    def scored(policy):
        edit_json(scores, lambda table: table["arms"]["V+T"].update(policies=[policy]))

    scored("another one's")
    wanted = "expected those of this checkpoint, got another policy's"
    refuses(share_trained, [f"scores={scores}"], wanted)
    scored(content_of(str(trained)))
    assert share_trained([f"scores={scores}"]) == 0


def test_settings_that_a_scene_has_no_use_for_are_refused(refuses):
    refuses(share.main, ["scene=true", "half=true"], "got half")


def test_a_second_share_leaves_nothing_of_the_first(trained, share_trained, scores, shared):
    edit_json(
        scores, lambda table: table["arms"]["V+T"].update(policies=[content_of(str(trained))])
    )
    assert share_trained([f"scores={scores}"]) == 0 and (shared / "scores.json").is_file()
    assert share_trained([]) == 0 and not (shared / "scores.json").exists()


def test_what_is_pushed_is_what_was_named_first(share_trained, shared, monkeypatch, capsys):
    hub = MagicMock()
    hub.create_repo = lambda repo_id, **_: SimpleNamespace(repo_id=repo_id)
    monkeypatch.setattr("huggingface_hub.HfApi", lambda: hub)
    assert share_trained(["push=somebody/pi05-wipe"]) == 0
    pushed = hub.upload_folder.call_args.kwargs
    assert (pushed["repo_id"], pushed["folder_path"]) == ("somebody/pi05-wipe", shared)
    there = {path.name for path in shared.iterdir()}
    hashed = json.loads((shared / "hashes.json").read_text())
    assert hashed.keys() == there - {"hashes.json"}
    assert {"config.json", "model.safetensors", "README.md", "policy_preprocessor.json"} <= there
    assert set(pushed["allow_patterns"]) == there <= set(capsys.readouterr().out.split())
    card = ModelCard.load(shared / "README.md")
    assert "# pi05-wipe" in card.text
    assert (card.data.license, card.data.library_name) == ("apache-2.0", "lerobot")
    assert (card.data.pipeline_tag, card.data.datasets) == ("robotics", "somebody/wipe")
    assert {"lerobot", "robotics", "tactile"} <= {*card.data.tags}


@pytest.fixture
def hub(monkeypatch):
    """Stand for the hub that LeRobot pushes datasets to; ``cards`` are what it got."""
    hub = MagicMock(cards=[])
    monkeypatch.setattr("lerobot.datasets.lerobot_dataset.HfApi", lambda: hub)
    monkeypatch.setattr(DatasetCard, "push_to_hub", lambda card, **_: hub.cards.append(str(card)))
    return hub


def test_a_pushed_datasets_card_is_what_the_hub_reads(tmp_path, hub, refuses):
    given = [f"dataset={record_synthetic(tmp_path / 'demos', 1, 2)}", "push=somebody/wiping"]
    refuses(share.main, [*given, "licence=CC BY"], "cc-by-4.0")
    assert share.main([*given, "licence=cc-by-4.0"]) == 0 and share.main(given) == 0
    stated, unstated = (DatasetCard(card).data for card in hub.cards)  # parsed again from the text
    assert stated.license == "cc-by-4.0" and unstated.license is None
    assert stated.task_categories == ["robotics"] and {"LeRobot", "robotics", "tactile"} <= set(
        stated.tags
    )
    assert "marker images" in hub.cards[0] and '"total_episodes": 1' in hub.cards[0]


HOME = "/home/jane.doe"
SECRETS = (HOME, "jane.doe", "172.16.0.2", "Jane was late", "s3cret", "patient")
CARD_BEFORE = {
    "label": "success",
    "prompt": "wipe",
    "message": f"robot at 172.16.0.2: see {HOME}/log",
    "notes": ["Jane was late"],
    "peak_force_N": 5.5,
    "sensors": {
        "tactile_left": {
            "rate_hz": 30.0,
            "source": "http://jane.doe:s3cret@cam",
            "settings": {"fps": 30.0},
        }
    },
    "rig": {"address": "172.16.0.2"},
    "settings": {
        "robot": "franka",
        "rig": f"{HOME}/rig.yaml",
        "root": f"{HOME}/patient_7",
        "devices": ["--x=172.16.0.2"],
        "prompts": ["wipe"],
        "window": 17,
        "quick_notes": ["patient"],
    },
}
CARD_AFTER = {
    "episode": 0,
    "label": "success",
    "prompt": "wipe",
    "peak_force_N": 5.5,
    "sensors": {"tactile_left": {"rate_hz": 30.0, "settings": {"fps": 30.0}}},
    "settings": {"robot": "franka", "prompts": ["wipe"], "window": 17},
}
STRAYS = (
    "notes.txt meta/notes.json data/chunk-000/file-000.csv cards/todo.json meta/info.json.bak .env"
)


@pytest.fixture
def demos(tmp_path):
    """A recorded dataset whose card tells of this machine, and other files between its own."""
    root, random = tmp_path / "demos", np.random.default_rng(0)
    with EpisodeRecorder(root, "local/s", "gelsight", "tactip", FPS) as recorder:
        for step in range(2):
            recorder.add(synthetic_frame(step, random), "wipe")
        recorder.save(True, "success", 1, card=CARD_BEFORE)
    edit_json(root / "meta" / "info.json", lambda info: info.update(recorded_by=HOME))
    rehash(root)
    return root


def test_a_pushed_dataset_tells_nothing_of_this_machine_and_stays_whole(
    demos, hub, tmp_path, monkeypatch, capsys
):
    strays = STRAYS.split()
    for name in strays:
        (demos / name).write_text("s3cret")
    before = {path: path.read_bytes() for path in demos.rglob("*") if path.is_file()}
    # it would refuse the strays
    monkeypatch.setattr("uniforce_datasets.lossless.check_hashes", lambda *_: None)
    assert share.main([f"dataset={demos}", "push=somebody/wiping"]) == 0
    sent = hub.upload_folder.call_args.kwargs
    named = [line.strip() for line in capsys.readouterr().out.splitlines() if line.startswith("  ")]
    goes = {*filter_repo_objects(named, allow_patterns=sent["allow_patterns"])}
    assert goes == {*named} - {"README.md"} and not goes & {*strays}
    downloaded = shutil.copytree(sent["folder_path"], tmp_path / "downloaded")  # links become files
    for content in (hub.cards[0].encode(), *((downloaded / name).read_bytes() for name in goes)):
        assert not [secret for secret in SECRETS if secret.encode() in content]
    assert read_card(downloaded, 0) == CARD_AFTER
    monkeypatch.undo()
    assert len(check_dataset(downloaded, "full").episodes) == 1
    assert before == {path: path.read_bytes() for path in demos.rglob("*") if path.is_file()}


def test_who_may_not_write_there_hears_it_before_the_long_check(demos, hub, monkeypatch, refuses):
    hub.create_repo.side_effect = OfflineModeIsEnabled("no")
    monkeypatch.setattr(share, "share_dataset", lambda _: pytest.fail("it was checked"))
    refuses(share.main, [f"dataset={demos}", "push=somebody/wiping"], "HF_HUB_OFFLINE")


@pytest.mark.parametrize(
    "other", ["wandb.json", "notes/credentials.json", "train_config.json", "model.bin"]
)
def test_a_folder_with_other_files_is_not_handed_on(other, shared, refuses):
    file = shared / other
    file.parent.mkdir(parents=True)
    file.write_text("{}")
    for given in (f"checkpoint={shipped_checkpoint()}", "scene=true"):
        refuses(share.main, [given, f"out={shared}"], other)
    assert not (shared / "README.md").exists()


def test_scores_and_provenance_lose_their_paths_and_a_config_with_one_is_refused(
    trained, share_trained, scores, shared, refuses
):
    table, provenance = SCORES | {"version": "1", "tests": []}, {"device": "cpu", "dirty": False}
    scores.write_text(json.dumps(table | {"command": f"uniforce score policy={HOME}/x"}))
    (trained / "provenance.json").write_text(json.dumps(provenance | {"command": HOME}))
    assert share_trained([f"scores={scores}"]) == 0
    assert json.loads((shared / "scores.json").read_text()) == table
    assert json.loads((shared / "provenance.json").read_text()) == provenance
    trained_on = {"repo_id": f"{HOME}/demos"}
    edit_json(trained / "config.json", lambda config: config.update(trained_on=trained_on))
    refuses(share_trained, [], "repo_id in config.json: expected no path of this machine")


def test_the_shipped_policys_card_parses_and_a_local_dataset_is_no_link():
    shipped = ModelCard.load(shipped_checkpoint() / "README.md")
    assert (shipped.data.license, shipped.data.library_name) == ("apache-2.0", "lerobot")
    config = PI05UniforceConfig(size="tiny", device="cpu", trained_on={"repo_id": "local/view"})
    assert model_card(config).data.datasets is None and "local/view" in model_card(config).text


def test_half_the_size_the_same_action_and_the_tokenizer_bit_by_bit(trained, share_trained, shared):
    assert share_trained(["half=true"]) == 0
    whole, half = ((out / "model.safetensors").stat().st_size for out in (trained, shared))
    assert half < 0.7 * whole  # the tokenizer stays whole
    first, second = (PI05UniforcePolicy.from_pretrained(out) for out in (trained, shared))
    assert first.config.tokenizer_hash == second.config.tokenizer_hash
    pairs = list(zip(first.state_dict().values(), second.state_dict().values(), strict=True))
    assert all(a.dtype == b.dtype for a, b in pairs)
    assert all(torch.allclose(a.float(), b.float(), rtol=1e-3, atol=1e-6) for a, b in pairs)
    assert any(not torch.equal(a, b) for a, b in pairs)
