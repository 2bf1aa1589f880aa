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
COUNTS = ("chunk_size", "n_action_steps", "num_inference_steps", "max_action_dim", "max_state_dim")
LIMITS = {**dict.fromkeys(COUNTS, 4096), "tokenizer_max_length": 65536}
TINY_LIMITS = {"width": 8192, "depth": 64, "mlp_dim": 65536}
MAX_SIDE = 4096  # of an image or a feature's axis
# raised by LeRobot, draccus and torch over settings that fit nothing
MISFITS = (
    *(ValueError, TypeError, KeyError, AttributeError, IndexError, RuntimeError, ArithmeticError),
    *(OSError, ImportError, AssertionError, DraccusException, SafetensorError),
)


def check_settings(saved: dict[str, Any], where: str) -> None:
    """Check a saved ``config.json``.

    Raises CheckpointError: another policy, settings of 0.1.0, a tokenizer elsewhere, other marker images, or a size no
    machine holds.
    """
    if saved.get("type") != TYPE:
        came = repr(saved.get("type"))[:80]
        raise CheckpointError(
            expected(f"policy type of {where}", TYPE, came, "Choose another folder.")
        )
    if "touch_input" in saved:
        do = "Its tokenizer is no longer shipped: run it with version 0.1.0, or train again."
        raise CheckpointError(
            expected(where, "settings in groups", "the form of version 0.1.0", do)
        )
    for name, only in NEVER_STORED.items():
        if saved.get(name, only) != only:
            do = "Only who loads a checkpoint chooses this. Copy it again."
            raise CheckpointError(
                expected(f"{name} in {where}", repr(only), repr(saved[name])[:80], do)
            )
    touch, tiny = (
        {} if not isinstance(saved.get(name), dict) else saved[name] for name in ("touch", "tiny")
    )
    encodes = touch.get("input") in ENCODED and touch.get("slots")
    if not touch or (encodes and not isinstance(touch.get("tokenizer"), dict)):
        do = "A checkpoint names its tokenizer; a path to another one is never followed. Copy it again."
        raise CheckpointError(expected(f"touch.tokenizer in {where}", "sizes and hash", "none", do))
    came = touch.get("marker_images", 1)
    if touch.get("slots") and touch.get("input") in ENCODED and came != MARKER_IMAGES:
        do = "Train again, on demonstrations recorded with this version."
        raise CheckpointError(
            expected(f"marker images of {where}", f"version {MARKER_IMAGES}", came, do)
        )
    if touch.get("slots") and touch.get("input") == "newtons" and not touch.get("head_hash"):
        do = "Train again with this version: a policy that feels newtons names the head that reads them."
        raise CheckpointError(expected(f"touch.head_hash in {where}", "a hash", "none", do))
    try:
        for limits, numbers in ((LIMITS, saved), (TINY_LIMITS, tiny)):
            for name, most in limits.items():
                if numbers.get(name) is not None:
                    check_count(name, numbers[name], most)
        for side in _sides(saved):
            check_count("a side", side, MAX_SIDE)
    except ContractError as error:
        do = "It is damaged: copy the checkpoint again."
        raise CheckpointError(expected(where, "sizes a machine can hold", error, do)) from error


def _sides(saved: dict[str, Any]) -> list[Any]:
    features = [saved.get(name) for name in ("input_features", "output_features")]
    found = [
        entry for feature in features if isinstance(feature, dict) for entry in feature.values()
    ]
    shapes = [
        saved.get("image_resolution"),
        *(e.get("shape") for e in found if isinstance(e, dict)),
    ]
    return [side for shape in shapes if isinstance(shape, list) for side in shape]


def check_processors(folder: Path) -> None:
    """Check the stored processors of a checkpoint's folder, where there are any.

    LeRobot imports and calls whatever class a step names; only steps that registered themselves are let through, so
    that a checkpoint can't run a program of its choice.

    Raises CheckpointError: damaged, a step that names a class, or a state outside the folder, or with NaN or inf.
    """
    for name in PROCESSORS:
        if not (folder / name).is_file():
            continue
        steps = read_object(folder / name, CheckpointError).get("steps")
        if not isinstance(steps, list) or not steps:
            raise CheckpointError(
                expected(str(folder / name), "steps", repr(steps)[:80], "Copy it again.")
            )
        for step in steps:
            _check_step(folder / name, step)
            state = folder / str(step.get("state_file"))
            if state.is_file():  # else LeRobot says so, or fetches it
                with weights.opened(state) as stored:
                    for tensor in stored.keys():  # noqa: SIM118 (not a dict)
                        weights.finite(stored.get_tensor(tensor), f"{tensor} of {state}")


def _check_step(file: Path, step: Any) -> None:
    if (
        not isinstance(step, dict)
        or not isinstance(step.get("registry_name"), str)
        or "class" in step
    ):
        came, do = repr(step)[:80], "Only registered steps are run. Who wrote this checkpoint?"
        raise CheckpointError(expected(f"a step in {file}", "a registry_name", came, do))
    state = str(step.get("state_file") or "absent.safetensors")
    if state != Path(state).name or "\\" in state or not state.endswith(".safetensors"):
        do = "Copy the checkpoint again."
        raise CheckpointError(
            expected(f"state of a step in {file}", "a file beside it", state[:80], do)
        )


@contextmanager
def misfits_named(where: str) -> Iterator[None]:
    """Turn what libraries raise over settings that fit nothing into a CheckpointError."""
    try:
        yield
    except MISFITS as error:
        came = f"{type(error).__name__}: {error}"[:300]
        do = "It is damaged, or of another version: copy the checkpoint again."
        raise CheckpointError(expected(where, "settings of this policy", came, do)) from error


def check_same(saved: Mapping[str, Any], running: PI05UniforceConfig) -> None:
    """Raise CheckpointError naming every fact of touch that differs between a checkpoint and the running config."""
    stored, now = _facts(saved["touch"]), _facts(vars(running.touch))
    differing = [name for name in stored if stored[name] != now[name]]
    if differing:
        wanted, came = ({name: facts[name] for name in differing} for facts in (stored, now))
        do = (
            "Run the checkpoint with its own tokenizer and slots; only swap and sensors may change."
        )
        raise CheckpointError(expected("touch settings", wanted, came, do))


def _facts(touch: Mapping[str, Any]) -> dict[str, Any]:
    tokenizer = (touch["tokenizer"] or {}).get("hash", "")
    alike = {name: touch[name] for name in ("input", "site")}
    return {"slots": sorted(touch["slots"] or ()), "tokenizer": tokenizer, **alike}


def check_sensors(config: PI05UniforceConfig, mounted: Mapping[Finger, str]) -> list[str]:
    """Return one line per slot that runs on another kind of sensor than it was trained on; log and store them.

    Args:
        config: the policy's config; ``swap`` or ``left_sensor``/``right_sensor`` ask for a change.
        mounted: finger → kind of sensor worn now.

    Raises CheckpointError: a slot's sensor differs without being asked for.
    """
    notes = []
    for slot, finger in config.finger_by_slot().items():
        trained, worn = config.touch.trained_sensors.get(slot, ""), mounted.get(finger, "")
        if not trained or not worn or worn in trained.split("+"):
            continue
        if getattr(config, f"{finger}_sensor") != worn and finger == config.touch.slots[slot]:
            do = f"Say swap={slot}:FINGER or {finger}_sensor={worn} if you mean it."
            raise CheckpointError(
                expected(f"sensor of {slot} ({finger} finger)", trained, worn, do)
            )
        notes.append(f"{slot}: trained on {trained}, now {worn} on the {finger} finger")
        logger.warning("Sensor swap, as asked: %s", notes[-1])
    return notes
