"""Put a policy, a dataset or the scene into one folder to hand on, and on request onto the hub."""

from __future__ import annotations

import atexit
import glob
import re
import shutil
import tempfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from uniforce_cli import allowed
from uniforce_cli.boundary import command, one_thread, refuse_unused
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.file_hashes import HASHES, hashed_names, write_hashes
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import Dataset, Existing, FilePath, HubName, OutFolder, Pattern
from uniforce_vtla.results_file import PROVENANCE, write_json

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce import PI05UniforcePolicy

SCORES = "scores.json"
TRAIN_CONFIG = "train_config.json"
ADAPTER = "adapter_config.json"
TOKENIZER = "model.tactile_encoder."
CARD = "README.md"
SCENE_FILES = ("env.py", CARD)
SCENE_NAMES = re.compile(r"env\.py|README\.md")
TAGS = ["lerobot", "robotics", "tactile", "uniforce"]
DESCRIPTION = "Demonstrations with marker images of tactile sensors, recorded with uniforce-vtla."
TrainedPolicy = Annotated[str, Existing("a checkpoint's folder", "config.json")]
Licence = Annotated[str, Pattern("a licence's name", r"[a-z0-9][a-z0-9.-]{0,60}", "cc-by-4.0")]


@dataclass
class ShareConfig:
    """Write weights, processors, tokenizers, model card and scores of a policy into one folder.

    ``push`` uploads it. Every file to upload is named first, and no other file is sent. Cards and
    settings lose notes, addresses and paths; allowed.py lists what stays.

    Example: uniforce share checkpoint=outputs/train/checkpoints/last/pretrained_model
    with its scores: uniforce share … scores=outputs/score/wiping.json
    then: uniforce share … push=your-name/pi05-wiping  (needs `hf auth login`)
    a dataset: uniforce share dataset=outputs/demos push=your-name/wiping licence=cc-by-4.0
    the scene, for LeRobot's EnvHub: uniforce share scene=true push=your-name/wipe-by-touch
    """

    # policy that the trainer saved: …/checkpoints/last/pretrained_model
    checkpoint: TrainedPolicy = ""
    # folder to hand on, with nothing else in it; no path of this machine is left in its files
    out: OutFolder = "outputs/shared"
    scores: FilePath = ""  # wiping.json of uniforce score; "" = the card says "not scored"
    push: HubName = ""  # hub repository, name/model; "" = nothing leaves this machine
    private: bool = False  # make a new hub repository private
    # instead of a checkpoint: a recorded dataset's folder, checked in full, then pushed
    dataset: Dataset = ""
    # instead of a checkpoint: env.py and a card of the scene, for LeRobot's
    # make_env("name/repository")
    scene: bool = False
    # licence of the dataset, as the hub spells it; "" = its card names none
    licence: Licence = ""
    # store trained weights as float16, half the size; the policy computes as before
    half: bool = False


def share(config: ShareConfig) -> Path:
    """Load the checkpoint strictly, write it whole, and return the folder.

    Raises CheckpointError: files that are missing, damaged or don't fit; ContractError: scores of
    another policy, or none.
    """
    from lerobot.policies.factory import make_pre_post_processors

    from lerobot_policy_pi05_uniforce.model_card import model_card

    source = Path(config.checkpoint)
    out = Path(config.out)
    scores = _read(Path(config.scores))
    trained = _read(source / PROVENANCE)
    _check_scores(scores, source)
    policy = _load(source)
    processors = make_pre_post_processors(policy.config, pretrained_path=str(source))
    # paths of this machine
    policy.config.touch.tokenizer_path = None
    policy.config.pretrained_path = None
    if policy.config.text_tokenizer_name and Path(policy.config.text_tokenizer_name).exists():
        policy.config.text_tokenizer_name = None
    policy.config.repo_id = config.push or policy.config.repo_id
    card = model_card(policy.config, _read(source / TRAIN_CONFIG), scores)
    if config.half:  # the frozen tokenizer's weights stay, since its hash is of every bit
        for name, weight in policy.named_parameters():
            if not name.startswith(TOKENIZER):
                weight.data = weight.data.half()
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".share-") as folder:
        fresh = Path(folder)
        for part in (policy, *processors):
            part.save_pretrained(fresh)
        card.save(fresh / CARD)
        if scores is not None:
            write_json(fresh / SCORES, allowed.keep_listed(scores, allowed.SCORES))
        if trained is not None:
            write_json(fresh / PROVENANCE, allowed.keep_listed(trained, allowed.PROVENANCE))
        allowed.refuse_paths(fresh)
        write_hashes(fresh)
        for old in out.iterdir():  # of an earlier share, e.g. its scores
            if allowed.POLICY_FILES.fullmatch(old.name):
                old.unlink()
        for file in fresh.iterdir():
            file.replace(out / file.name)
    return out


def _check_scores(scores: dict[str, Any] | None, source: Path) -> None:
    """Raise ContractError where a table names its policies, and this checkpoint is none of them."""
    from uniforce_cli.score import content_of

    arms = (scores or {}).get("arms")
    acted = []
    if isinstance(arms, dict):
        for arm in arms.values():
            acted += arm.get("policies", [])
    if acted and content_of(str(source)) not in acted:
        do = "Score it: uniforce score policy=… out=a new folder"
        raise ContractError(expected("scores", "those of this checkpoint", "another policy's", do))


def _load(source: Path) -> PI05UniforcePolicy:
    """Return the policy, LoRA merged into its weights."""
    from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
    from lerobot_policy_pi05_uniforce.checkpoint import check_settings

    saved = read_object(source / "config.json", CheckpointError)
    adapter = _read(source / ADAPTER)
    if adapter is not None:
        return _merged(source, adapter["base_model_name_or_path"])
    check_settings(saved, str(source))  # before anything is logged
    return PI05UniforcePolicy.from_pretrained(source, warm=False)


def _merged(source: Path, base: str) -> PI05UniforcePolicy:
    if find_spec("peft") is None:
        raise CheckpointError(
            expected(str(source), "the package peft", "none", "pip install 'lerobot[peft]'")
        )
    from lerobot.configs import PreTrainedConfig
    from peft import PeftModel  # an extra, for those who train adapters

    from lerobot_policy_pi05_uniforce import PI05UniforcePolicy, weights

    weights.check_files(source, "full", None, local_files_only=True)
    plain = PI05UniforcePolicy.from_pretrained(base, warm=False)
    policy = PeftModel.from_pretrained(plain, source).merge_and_unload()
    policy.config = PreTrainedConfig.from_pretrained(source)
    policy.config.use_peft = False
    return policy


def files_to_share(folder: Path, config: ShareConfig) -> list[str]:
    """Return the names of the files that ``share`` or ``share_scene`` wrote into a folder."""
    if config.scene:
        return sorted(SCENE_FILES)
    return sorted([*hashed_names(folder, CheckpointError), HASHES])


def push(folder: Path, config: ShareConfig) -> str:
    """Upload what was written into the folder, in one commit; return the repository's address."""
    from huggingface_hub import HfApi

    api = HfApi()
    names = files_to_share(folder, config)
    _say(folder, names, config.push)
    repository = api.create_repo(repo_id=config.push, private=config.private, exist_ok=True)
    only = list(map(glob.escape, names))
    api.upload_folder(repo_id=repository.repo_id, folder_path=folder, allow_patterns=only)
    return str(repository)


def _say(folder: Path, names: list[str], repository: str) -> None:
    """Print every file that is about to be uploaded."""
    total_MB = sum((folder / name).stat().st_size for name in names) / 1e6
    print(f"these go to {repository}, {total_MB:.1f} MB, and nothing else:")
    for name in sorted({*names, CARD}):  # LeRobot writes a dataset's, of meta/info.json
        print(f"  {name}", flush=True)


def check_login(config: ShareConfig) -> None:
    """Make the repository before anything that takes long; only a login that may write can."""
    if config.dataset:
        from lerobot.datasets.lerobot_dataset import HfApi  # with which it uploads

        kind = "dataset"
    else:
        from huggingface_hub import HfApi

        kind = "model"
    HfApi().create_repo(repo_id=config.push, private=config.private, repo_type=kind, exist_ok=True)


def share_dataset(config: ShareConfig) -> str:
    """Check a recorded dataset in full and push it where asked; return a line about it.

    A copy is pushed that holds only what the lists of ``allowed.py`` name; the dataset itself stays
    as it is.

    Raises DatasetError: it isn't what was saved; nothing is pushed.
    """
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from uniforce_datasets.lossless import open_dataset
    from uniforce_datasets.staged_writer import LOCAL

    dataset = open_dataset(config.dataset, config.push or "local/dataset", verify="full")
    if not config.push:
        episodes = f"{dataset.num_episodes} episodes"
        return f"{config.dataset} is whole: {episodes}; push=name/dataset uploads it"
    staged = Path(tempfile.mkdtemp(prefix="uniforce_share_"))
    atexit.register(shutil.rmtree, staged, ignore_errors=True)
    names = allowed.stage_dataset(Path(config.dataset), staged)
    dataset = LeRobotDataset(config.push, staged, revision=LOCAL, video_backend="pyav")
    _say(staged, names, config.push)
    card = {"tags": TAGS, "license": config.licence or None, "dataset_description": DESCRIPTION}
    only = list(map(glob.escape, names))
    dataset.push_to_hub(private=config.private, allow_patterns=only, **card)
    return f"pushed {dataset.num_episodes} episodes to {config.push}"


def share_scene(config: ShareConfig) -> Path:
    """Write the EnvHub form of the wiping scene and return the folder."""
    import lerobot_env_uniforce_wiping

    hub = Path(lerobot_env_uniforce_wiping.__file__).with_name("hub")
    out = Path(config.out)
    out.mkdir(parents=True, exist_ok=True)
    for name in SCENE_FILES:
        text = (hub / name).read_text()
        if config.push:
            text = text.replace("NAME/REPOSITORY", config.push)
        (out / name).write_text(text)
    return out


def _read(path: Path) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    return read_object(path, CheckpointError)


@command(ShareConfig)
def main(config: ShareConfig) -> int:
    one_thread()
    _read(Path(config.scores))  # a damaged file is named first
    named = [name for name in ("checkpoint", "dataset", "scene") if getattr(config, name)]
    if len(named) != 1:
        came = " and ".join(named) or "none"
        raise ContractError(
            expected("share", "checkpoint=…, dataset=… or scene=true", came, "Name one.")
        )
    if not config.checkpoint:
        refuse_unused(config, f"{named[0]}=", ("scores", "half"))
    if config.scene:
        allowed.refuse_others(Path(config.out), SCENE_NAMES)
    if config.checkpoint:
        allowed.refuse_others(Path(config.out), allowed.POLICY_FILES)
    if config.push:
        check_login(config)
    if config.dataset:
        print(share_dataset(config))
        return 0
    out = share_scene(config) if config.scene else share(config)
    print(f"everything is in {out}; read {out / CARD} before you hand it on")
    if config.push:
        print(f"pushed to {push(out, config)}")
    return 0
