"""Check a checkpoint's JSON files before anything is built, opened or imported because of them."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from draccus.utils import DraccusException
from safetensors import SafetensorError

from lerobot_policy_pi05_uniforce import weights
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import (
    ENCODED,
    NEVER_STORED,
    REMOVED,
    PI05UniforceConfig,
)
from uniforce_vtla.contracts import Finger, check_count
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.markers import MARKER_IMAGES

logger = logging.getLogger(__name__)

TYPE = "pi05_uniforce"
PROCESSORS = ("policy_preprocessor.json", "policy_postprocessor.json")
# of whole numbers in config.json: far beyond what is ever trained, far below what fills a machine
LIMITS = {
    "chunk_size": 4096,
    "n_action_steps": 4096,
    "num_inference_steps": 4096,
    "max_action_dim": 4096,
    "max_state_dim": 4096,
    "tokenizer_max_length": 65536,
}
TINY_LIMITS = {"width": 8192, "depth": 64, "mlp_dim": 65536}
MAX_SIDE = 4096  # of an image or a feature's axis
# raised by LeRobot, draccus and torch over settings that fit nothing
MISFITS = (
    *(ValueError, TypeError, KeyError, AttributeError, IndexError, RuntimeError, ArithmeticError),
    *(OSError, ImportError, AssertionError, DraccusException, SafetensorError),
)


def check_settings(saved: dict[str, Any], where: str) -> None:
    """Check a saved ``config.json``.

    Raises CheckpointError: another policy, settings of 0.1.0 or of what was removed since, a
    tokenizer elsewhere, other marker images, or a size no machine holds.
    """

    def require(fits: object, what: str, wanted: str, came: object, do: str) -> None:
        if not fits:
            raise CheckpointError(expected(what, wanted, came, do))

    came = repr(saved.get("type"))[:80]
    is_ours = saved.get("type") == TYPE
    require(is_ours, f"policy type of {where}", TYPE, came, "Choose another folder.")
    do = "Its tokenizer is no longer shipped: run it with version 0.1.0, or train again."
    is_grouped = "touch_input" not in saved
    require(is_grouped, where, "settings in groups", "the form of version 0.1.0", do)
    for name, only in NEVER_STORED.items():
        value = saved.get(name, only)
        do = "Only who loads a checkpoint chooses this. Copy it again."
        require(value == only, f"{name} in {where}", repr(only), repr(value)[:80], do)
    for path, runs in REMOVED.items():
        group, _, name = path.partition(".")
        value = _table(saved, group).get(name, runs)
        do = "It didn't pay and was removed: run it with commit 304b337e, or train again."
        require(value == runs, f"{path} in {where}", repr(runs), repr(value)[:80], do)
    touch = _table(saved, "touch")
    encodes = touch.get("slots") and touch.get("input") in ENCODED
    is_whole = touch and (not encodes or isinstance(touch.get("tokenizer"), dict))
    do = "A checkpoint names its tokenizer; a path to another one is never followed. Copy it again."
    require(is_whole, f"touch.tokenizer in {where}", "sizes and hash", "none", do)
    if encodes:
        version = touch.get("marker_images", 1)
        wanted = f"version {MARKER_IMAGES}"
        do = "Train again, on demonstrations recorded with this version."
        require(version == MARKER_IMAGES, f"marker images of {where}", wanted, version, do)
        has_head = touch["input"] == "latent" or touch.get("head_hash")
        do = (
            "Train again with this version: "
            "a policy that feels newtons names the head that reads them."
        )
        require(has_head, f"touch.head_hash in {where}", "a hash", "none", do)
    try:
        _check_sizes(saved)
    except ContractError as error:
        do = "It is damaged: copy the checkpoint again."
        raise CheckpointError(expected(where, "sizes a machine can hold", error, do)) from error


def _table(saved: dict[str, Any], name: str) -> dict[str, Any]:
    """Return a table of a saved one; empty where there is none."""
    found = saved.get(name)
    return found if isinstance(found, dict) else {}


def _check_sizes(saved: dict[str, Any]) -> None:
    for limits, numbers in ((LIMITS, saved), (TINY_LIMITS, _table(saved, "tiny"))):
        for name, most in limits.items():
            if numbers.get(name) is not None:
                check_count(name, numbers[name], most)
    shapes = [saved.get("image_resolution")]
    for name in ("input_features", "output_features"):
        features = _table(saved, name)
        shapes += [_table(features, key).get("shape") for key in features]
    for shape in shapes:
        if isinstance(shape, list):
            for side in shape:
                check_count("a side", side, MAX_SIDE)


def check_processors(folder: Path) -> None:
    """Check the stored processors of a checkpoint's folder, where there are any.

    LeRobot imports and calls whatever class a step names. Only steps that registered themselves are
    let through, so that a checkpoint can't run a program of its choice.

    Raises CheckpointError: damaged, a step that names a class, or a state outside the folder, or
    with NaN or inf.
    """
    for name in PROCESSORS:
        file = folder / name
        if not file.is_file():
            continue
        steps = read_object(file, CheckpointError).get("steps")
        if not isinstance(steps, list) or not steps:
            came = repr(steps)[:80]
            raise CheckpointError(expected(str(file), "steps", came, "Copy it again."))
        for step in steps:
            _check_step(file, step)


def _check_step(file: Path, step: Any) -> None:
    registered = isinstance(step, dict) and isinstance(step.get("registry_name"), str)
    if not registered or "class" in step:
        came = repr(step)[:80]
        do = "Only registered steps are run. Who wrote this checkpoint?"
        raise CheckpointError(expected(f"a step in {file}", "a registry_name", came, do))
    name = str(step.get("state_file") or "absent.safetensors")
    if name != Path(name).name or "\\" in name or not name.endswith(".safetensors"):
        wanted = "a file beside it"
        do = "Copy the checkpoint again."
        raise CheckpointError(expected(f"state of a step in {file}", wanted, name[:80], do))
    state = file.parent / name
    if state.is_file():  # else LeRobot says so, or fetches it
        with weights.opened(state) as stored:
            for tensor in stored.keys():  # noqa: SIM118 (not a dict)
                weights.check_finite(stored.get_tensor(tensor), f"{tensor} of {state}")


@contextmanager
def misfits_named(where: str) -> Iterator[None]:
    """Turn the libraries' errors over settings that fit nothing into a CheckpointError."""
    try:
        yield
    except MISFITS as error:
        came = f"{type(error).__name__}: {error}"[:300]
        do = "It is damaged, or of another version: copy the checkpoint again."
        raise CheckpointError(expected(where, "settings of this policy", came, do)) from error


def check_same(saved: Mapping[str, Any], running: PI05UniforceConfig) -> None:
    """Raise CheckpointError naming every fact of touch that differs from the running config."""
    now = _facts(vars(running.touch))
    wanted = {}
    came = {}
    for name, fact in _facts(saved["touch"]).items():
        if fact != now[name]:
            wanted[name] = fact
            came[name] = now[name]
    if wanted:
        do = (
            "Run the checkpoint with its own tokenizer and slots; only swap and sensors may change."
        )
        raise CheckpointError(expected("touch settings", wanted, came, do))


def _facts(touch: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "slots": sorted(touch["slots"] or ()),
        "tokenizer": (touch["tokenizer"] or {}).get("hash", ""),
        "input": touch["input"],
    }


def check_sensors(config: PI05UniforceConfig, mounted: Mapping[Finger, str]) -> list[str]:
    """Return one line per slot that runs on another type of sensor than it was trained on; log it.

    Args:
        config: the policy's config; ``swap`` or ``left_sensor``/``right_sensor`` ask for a change.
        mounted: finger → type of sensor mounted now.

    Raises CheckpointError: a slot's sensor differs without being asked for.
    """
    notes = []
    for slot, finger in config.finger_by_slot().items():
        trained = config.touch.trained_sensors.get(slot, "")
        now = mounted.get(finger, "")
        if not trained or not now or now in trained.split("+"):
            continue
        if getattr(config, f"{finger}_sensor") != now and finger == config.touch.slots[slot]:
            do = f"Say swap={slot}:FINGER or {finger}_sensor={now} if you mean it."
            raise CheckpointError(expected(f"sensor of {slot} ({finger} finger)", trained, now, do))
        notes.append(f"{slot}: trained on {trained}, now {now} on the {finger} finger")
        logger.warning("Sensor swap, as asked: %s", notes[-1])
    return notes
