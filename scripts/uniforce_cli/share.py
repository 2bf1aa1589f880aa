"""Put everything a stranger needs of a policy into one folder, and on request onto the hub."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import torch
from huggingface_hub import HfApi
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import make_pre_post_processors

from lerobot_policy_pi05_uniforce import PI05UniforcePolicy, weights
from lerobot_policy_pi05_uniforce.model_card import CARD, model_card
from uniforce_cli.boundary import command
from uniforce_datasets.lossless import open_dataset
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.evaluation.arms import scores_of
from uniforce_vtla.file_hashes import write_hashes
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import Dataset, Existing, FilePath, HubName, OutFolder, Text
from uniforce_vtla.results_file import write_json

SCORES, TRAIN_CONFIG, ADAPTER = "scores.json", "train_config.json", "adapter_config.json"
TOKENIZER = "model.tactile_encoder."
UPLOADED = ["*.safetensors", "*.json", CARD]


TrainedPolicy = Annotated[str, Existing("a checkpoint's folder", "config.json")]


@dataclass
class ShareConfig:
    """Write weights, processors, tokenizers, model card and scores of a policy into one folder; push it on request.

    Example: uniforce share checkpoint=outputs/train/checkpoints/last/pretrained_model scores=outputs/score/wiping.json
    then: uniforce share … push=your-name/pi05-wiping  (needs `hf auth login`)
    a dataset: uniforce share dataset=outputs/demos push=your-name/wiping
    """

    checkpoint: TrainedPolicy = ""  # what the trainer saved: …/checkpoints/last/pretrained_model
    out: OutFolder = "outputs/shared"  # folder to hand on; no path of this machine is left in it
    scores: FilePath = ""  # wiping.json of uniforce score; "" = the card says "not scored"
    # in a wiping.json of benchmarks.wiping, this checkpoint's own scores: …/seed0/vt as it was scored there; "" = all
    scored_as: Text = ""
    push: HubName = ""  # hub repository, name/model; "" = nothing leaves this machine
    private: bool = False  # of a new hub repository
    dataset: Dataset = (
        ""  # instead of a checkpoint: a recorded dataset's folder, checked in full, then pushed
    )
    half: bool = False  # store trained weights as float16, half the size; they are computed with as before


def share(config: ShareConfig) -> Path:
    """Load the checkpoint strictly, write it whole, and return the folder.

    Raises:
        CheckpointError: files that are missing, damaged or don't fit.
        ContractError: scores that aren't.
    """
    source, out = Path(config.checkpoint), Path(config.out)
    policy = _load(source)
    processors = make_pre_post_processors(policy.config, pretrained_path=str(source))
    _forget_this_machine(policy.config)
    policy.config.repo_id = config.push or policy.config.repo_id
    training, scores = _read(source / TRAIN_CONFIG), _scores(config.scores, config.scored_as)
    card = model_card(policy.config, training, scores)
    if config.half:
        _halve(policy)
    for part in (policy, *processors):
        part.save_pretrained(out)
    card.save(out / CARD)
    if scores is not None:
        write_json(out / SCORES, scores)
    write_hashes(out)
    return out


def _load(source: Path) -> PI05UniforcePolicy:
    """Return the policy, LoRA merged into its weights, without what only training needs."""
    adapter = _read(source / ADAPTER)
    if adapter is None:
        policy = PI05UniforcePolicy.from_pretrained(source)
    else:
        policy = _merged(source, adapter["base_model_name_or_path"])
    policy.model.next_force, policy.config.touch.next_force_weight = None, 0.0
    return policy


def _halve(policy: PI05UniforcePolicy) -> None:
    """Round trained weights to float16; the frozen tokenizer's stay, since its hash is of every bit."""
    for name, weight in policy.named_parameters():
        if not name.startswith(TOKENIZER):
            weight.data = weight.data.half()


def _merged(source: Path, base: str) -> PI05UniforcePolicy:
    if find_spec("peft") is None:
        raise CheckpointError(
            expected(str(source), "the package peft", "none", "pip install 'lerobot[peft]'")
        )
    from peft import PeftModel  # an extra: only who trains adapters has it

    weights.check_files(source, "full", None, local_files_only=True)
    policy = PeftModel.from_pretrained(PI05UniforcePolicy.from_pretrained(base), source).merge_and_unload()
    policy.config = PreTrainedConfig.from_pretrained(source)
    policy.config.use_peft = False
    return policy


def push(folder: Path, config: ShareConfig) -> str:
    """Upload the folder in one commit; return the repository's address."""
    api = HfApi()
    repository = api.create_repo(repo_id=config.push, private=config.private, exist_ok=True)
    api.upload_folder(repo_id=repository.repo_id, folder_path=folder, allow_patterns=UPLOADED)
    return str(repository)


def share_dataset(config: ShareConfig) -> str:
    """Check a recorded dataset in full and push it where asked; return a line about it.

    Raises:
        DatasetError: it isn't what was saved; nothing is pushed.
    """
    dataset = open_dataset(config.dataset, config.push or "local/dataset", verify="full")
    if not config.push:
        return f"{config.dataset} is whole: {dataset.num_episodes} episodes; push=name/dataset uploads it"
    dataset.push_to_hub(private=config.private, license=None)
    return f"pushed {dataset.num_episodes} episodes to {config.push}"


def _forget_this_machine(config: Any) -> None:
    """Drop paths nobody else has: both tokenizers are in the folder."""
    config.touch.tokenizer_path = config.pretrained_path = None
    if config.text_tokenizer_name and Path(config.text_tokenizer_name).exists():
        config.text_tokenizer_name = None


def _scores(path: str, scored_as: str) -> dict[str, Any] | None:
    found = _read(Path(path)) if path else None
    if path and found is None:
        raise CheckpointError(expected("scores", "a JSON file", path, "Run uniforce score first."))
    return scores_of(found, scored_as) if found and scored_as else found


def _read(path: Path) -> dict[str, Any] | None:
    return read_object(path, CheckpointError) if path.is_file() else None


@command(ShareConfig)
def main(config: ShareConfig) -> int:
    """Entry of ``uniforce share``."""
    torch.set_num_threads(1)
    if bool(config.dataset) == bool(config.checkpoint):
        came = "both" if config.dataset else "neither"
        raise ContractError(expected("share", "checkpoint=… or dataset=…", came, "Name one."))
    if config.dataset:
        print(share_dataset(config))
        return 0
    out = share(config)
    print(f"everything is in {out}; read {out / CARD} before you hand it on")
    if config.push:
        print(f"pushed to {push(out, config)}")
    return 0
