"""The parts of LeRobot that aren't its public interface: two patches, and the private names in use.

LeRobot has no hook where its trainer makes a dataset and saves a checkpoint, so ``training_views``
replaces both functions for the length of one training. A third patch is the robot's own:
``uniforce_robots.franka.robot`` keeps LeRobot's rollout from leading the arm back to its start.

``PRIVATE`` has every other private name. ``tests/scripts/test_compat.py`` compares it with the code
and with the installed LeRobot, so a name that a later LeRobot drops is named there.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from lerobot.datasets import factory
from lerobot.scripts import lerobot_train
from lerobot.utils.constants import PRETRAINED_MODEL_DIR

from lerobot_policy_pi05_uniforce.action import CHECK_ACTION
from lerobot_policy_pi05_uniforce.checkpoint import PROCESSORS, TYPE
from lerobot_policy_pi05_uniforce.weights import CONFIG
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.file_hashes import write_hashes
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import VIEW_MARKER
from uniforce_vtla.options import shortened
from uniforce_vtla.results_file import PROVENANCE, provenance, write_json

# LeRobot's module → its private names that we import, override, call or read
PRIVATE = {
    "lerobot.configs.policies": ("_save_pretrained",),
    "lerobot.datasets.dataset_metadata": ("_load_metadata", "_metadata_buffer"),
    "lerobot.datasets.dataset_writer": ("_meta", "_streaming_encoder"),
    "lerobot.datasets.video_utils": (
        "_CameraEncoderThread",
        "_dropped_frames",
        "_episode_active",
        "_frame_queues",
        "_result_queues",
        "_stop_events",
        "_threads",
        "_video_paths",
    ),
    "lerobot.policies.pi05.modeling_pi05": (
        "_action_queue",
        "_get_default_peft_targets",
        "_preprocess_images",
        "_rtc_enabled",
        "_set_requires_grad",
    ),
    "lerobot.policies.pi_gemma": ("_gated_residual",),
    "lerobot.policies.pretrained": ("_get_default_peft_targets", "_save_pretrained"),
    "lerobot.processor.tokenizer_processor": ("_tokenize_text",),
    "lerobot.rollout.strategies.core": ("_return_to_initial_position",),
    "lerobot.utils.hub": ("_save_pretrained",),
}


@contextmanager
def training_views(verify: str = "") -> Iterator[None]:
    """Let LeRobot's trainer read training views, check its dataset, and hash its checkpoints.

    ``verify`` says how thoroughly datasets are checked; "" leaves it to their repo id.
    """
    with ExitStack() as undo:
        undo.enter_context(_replaced(factory, "make_dataset", partial(_make_dataset, verify)))
        undo.enter_context(_replaced(lerobot_train, "save_checkpoint", _save_hashed))
        yield


@contextmanager
def _replaced(owner: Any, name: str, stand_in: Callable[..., Any]) -> Iterator[None]:
    """Let ``stand_in(stock, …)`` answer for a function of LeRobot's."""
    stock = getattr(owner, name)
    setattr(owner, name, partial(stand_in, stock))
    try:
        yield
    finally:
        setattr(owner, name, stock)


def _make_dataset(verify: str, stock: Any, cfg: Any) -> Any:
    """Return the training view at the dataset's root, or else LeRobot's dataset; both checked."""
    # pulls in the recorder's libraries
    from uniforce_datasets.training_view import make_training_dataset

    root = cfg.dataset.root
    if root is None or not (Path(root) / VIEW_MARKER).is_file():
        return make_training_dataset(cfg, partial(_stock_dataset, stock), verify)
    if cfg.dataset.eval_split:
        do = "Make a view of the held-out episodes instead."
        came = cfg.dataset.eval_split
        wanted = "0 with a training view"
        raise ContractError(expected("dataset.eval_split", wanted, came, do))
    return make_training_dataset(cfg, stock, verify)


def _stock_dataset(stock: Any, cfg: Any) -> Any:
    """Return LeRobot's dataset; ContractError: it can't be read from the folder or the hub."""
    where = cfg.dataset.root or cfg.dataset.repo_id
    try:
        return stock(cfg)
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        came = shortened(f"{type(error).__name__}: {error}", 300)
        do = "Look at it, or record it again."
        raise ContractError(expected("dataset", f"a whole dataset in {where}", came, do)) from error


def _save_hashed(stock: Any, checkpoint_dir: Path, **given: Any) -> None:
    """Save a checkpoint, its range of actions, its provenance and its ``hashes.json``.

    Here, since LeRobot saves the processors after the policy.
    """
    stock(checkpoint_dir=checkpoint_dir, **given)
    folder = checkpoint_dir / PRETRAINED_MODEL_DIR
    store_action_range(folder)
    write_json(folder / PROVENANCE, provenance())
    write_hashes(folder)


def store_action_range(folder: Path) -> None:
    """Write the range of a checkpoint's own demonstrations into its check of actions.

    Fine-tuning loads the processors of the checkpoint that it starts from. LeRobot renews their
    statistics and not this range, and rollouts would stop where only the new data went.
    """
    settings = read_object(folder / CONFIG, ContractError)
    bounds = settings.get("action", {}).get("target_range")
    if settings.get("type") != TYPE or not bounds:
        return
    path = folder / PROCESSORS[1]
    processor = read_object(path, ContractError)
    for step in processor["steps"]:
        if step["registry_name"] == CHECK_ACTION and step["config"]["low"]:
            step["config"]["low"], step["config"]["high"] = bounds
    write_json(path, processor)
