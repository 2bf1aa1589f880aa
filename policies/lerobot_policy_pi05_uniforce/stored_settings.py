"""What a checkpoint's JSON files ask for, checked before anything is built, opened or imported because of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from draccus.utils import DraccusException
from safetensors import SafetensorError

from lerobot_policy_pi05_uniforce import weights
from uniforce_vtla.contracts import check_count
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.json_file import read_object

TYPE = "pi05_uniforce"
PROCESSORS = ("policy_preprocessor.json", "policy_postprocessor.json")
LIMITS = {  # of whole numbers in config.json: far beyond what anybody trains, far below what fills a machine
    "tiny_width": 8192,
    "tiny_depth": 64,
    "tiny_head_dim": 1024,
    "tiny_mlp_dim": 65536,
    "tiny_vision_depth": 64,
    "chunk_size": 4096,
    "n_action_steps": 4096,
    "num_inference_steps": 4096,
    "max_action_dim": 4096,
    "max_state_dim": 4096,
    "tokenizer_max_length": 65536,
    "latent_grid": 64,
    "latent_size": 4096,
}
MAX_SIDE = 4096  # of an image or a feature's axis
# What LeRobot, draccus and torch raise over settings that fit nothing
MISFITS = (
    *(ValueError, TypeError, KeyError, AttributeError, IndexError, RuntimeError, ArithmeticError),
    *(OSError, ImportError, AssertionError, DraccusException, SafetensorError),
)


def check_settings(saved: dict[str, Any], where: str) -> None:
    """Check a saved ``config.json``.

    Raises:
        CheckpointError: another policy, a tokenizer outside the checkpoint, or a size no machine holds.
    """
    if saved.get("type") != TYPE:
        came = repr(saved.get("type"))[:80]
        raise CheckpointError(expected(f"policy type of {where}", TYPE, came, "Choose another folder."))
    feels = saved.get("touch_input") == "latent" and saved.get("touch_slots")
    if feels and not isinstance(saved.get("tokenizer_config"), dict):
        do = "A checkpoint holds its tokenizer; a path to another one is never followed. Copy it again."
        raise CheckpointError(expected(f"tokenizer_config in {where}", "sizes", "none", do))
    if saved.get("verify", "full") != "full":
        do = "Only who loads a checkpoint chooses how it is verified. Copy it again."
        raise CheckpointError(expected(f"verify in {where}", "full", repr(saved["verify"])[:80], do))
    try:
        for name, most in LIMITS.items():
            if saved.get(name) is not None:
                check_count(name, saved[name], most)
        for side in _sides(saved):
            check_count("a side", side, MAX_SIDE)
    except ContractError as error:
        do = "It is damaged: copy the checkpoint again."
        raise CheckpointError(expected(where, "sizes a machine can hold", error, do)) from error


def _sides(saved: dict[str, Any]) -> list[Any]:
    features = [saved.get(name) for name in ("input_features", "output_features")]
    found = [entry for feature in features if isinstance(feature, dict) for entry in feature.values()]
    shapes = [entry.get("shape") for entry in found if isinstance(entry, dict)]
    shapes.append(saved.get("image_resolution"))
    return [side for shape in shapes if isinstance(shape, list) for side in shape]


def check_processors(folder: Path) -> None:
    """Check the stored processors of a checkpoint's folder, where there are any.

    LeRobot imports and calls whatever class a step names; only steps that registered themselves are let through, so
    that a checkpoint can't run a program of its choice.

    Raises:
        CheckpointError: damaged, a step that names a class, or a state outside the folder, or with NaN or inf.
    """
    for name in PROCESSORS:
        if not (folder / name).is_file():
            continue
        steps = read_object(folder / name, CheckpointError).get("steps")
        if not isinstance(steps, list) or not steps:
            raise CheckpointError(expected(str(folder / name), "steps", repr(steps)[:80], "Copy it again."))
        for step in steps:
            _check_step(folder / name, step)
            _check_state(folder / str(step.get("state_file")))


def _check_step(file: Path, step: Any) -> None:
    named = isinstance(step, dict) and isinstance(step.get("registry_name"), str) and "class" not in step
    if not named:
        do = "Only registered steps are run. Who wrote this checkpoint?"
        raise CheckpointError(expected(f"a step in {file}", "a registry_name", repr(step)[:80], do))
    state = step.get("state_file")
    if state is not None and not (isinstance(state, str) and _beside(state)):
        do = "Copy the checkpoint again."
        raise CheckpointError(
            expected(f"state of a step in {file}", "a file beside it", repr(state)[:80], do)
        )


def _check_state(path: Path) -> None:
    if not path.is_file():
        return  # LeRobot says so, or fetches it
    with weights.opened(path, "processors' state") as stored:
        for name in stored.keys():  # noqa: SIM118 (not a dict)
            weights.finite(stored.get_tensor(name), f"{name} of {path}")


def _beside(name: str) -> bool:
    return name == Path(name).name and "\\" not in name and name.endswith(".safetensors")


@contextmanager
def misfits_named(where: str) -> Iterator[None]:
    """Turn what libraries raise over settings that fit nothing into a CheckpointError."""
    try:
        yield
    except MISFITS as error:
        came = f"{type(error).__name__}: {error}"[:300]
        do = "It is damaged, or of another version: copy the checkpoint again."
        raise CheckpointError(expected(where, "settings of this policy", came, do)) from error
