"""Damages of shipped checkpoints, each tried on a copy: every one must be refused at load."""

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load_file, save_file

from benchmarks.trust.injuries import Damage, cut, edit_text, flip_bit
from lerobot_policy_pi05_uniforce.controller import PolicyController, shipped_checkpoint
from uniforce_vtla.file_hashes import HASHES, write_hashes
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.weights import ASSETS

CONFIG, WEIGHTS, CARD = "config.json", "model.safetensors", "README.md"
PREPROCESSOR = "policy_preprocessor.json"
STATISTICS = "policy_preprocessor_step_3_normalizer_processor.safetensors"
SMALL, NANO, TOKENIZER = ASSETS / "small", ASSETS / "nano", "tokenizer"

Tensors = dict[str, torch.Tensor]


def link(file: Path, target: Path) -> None:
    file.unlink()
    file.symlink_to(target)


def change_tensors(file: Path, change: Callable[[Tensors], object]) -> None:
    tensors = load_file(file)
    change(tensors)
    save_file(tensors, file)


def save_weights(folder: Path, change: Callable[[Tensors], object]) -> None:
    """Change the weights and write the hashes again, as a careless saving would."""
    change_tensors(folder / WEIGHTS, change)
    write_hashes(folder)


def save_config(folder: Path, **settings: object) -> None:
    stored = json.loads((folder / CONFIG).read_text())
    (folder / CONFIG).write_text(json.dumps(stored | settings))
    write_hashes(folder)


def other_numbers(tensors: Tensors) -> None:
    next(tensor for tensor in tensors.values() if tensor.is_floating_point()).add_(0.01)


def made_nan(tensors: Tensors) -> None:
    next(iter(tensors.values())).view(-1)[0] = torch.nan


def another_tokenizer(folder: Path) -> None:
    """Name another tactile tokenizer in the config and write the hashes again."""
    touch = json.loads((folder / CONFIG).read_text())["touch"]
    touch["tokenizer"]["hash"] = "0" * 64
    save_config(folder, touch=touch)


def _read_force(folder: Path) -> None:
    """Read force with the head in ``folder`` through the default tokenizer."""
    image = np.zeros((1, 96, 128), np.uint8)
    image[:, 40:56, 40:56] = 255
    ForceHead.from_pretrained(path=folder)(Tokenizer.from_pretrained().encode(image, image))


def _kind(
    kind: str, sound: Path, load: Callable[[Path], object]
) -> Callable[[str, Callable[[Path], object]], Damage]:
    """Return what makes a damage of a shipped folder, which is always checked in full."""
    plain: Any = partial(
        Damage, load=lambda folder, verify: load(folder), of="checkpoint", sound=sound
    )
    return lambda name, do: plain(f"{kind}: {name}", do)


_policy = _kind("policy", shipped_checkpoint(), lambda folder: PolicyController(folder, {}))
_tokenizer = _kind("tokenizer", SMALL / TOKENIZER, Tokenizer.from_pretrained)
_head = _kind("force head", SMALL / "force_head_tactip", _read_force)

CHECKPOINT_DAMAGES: tuple[Damage, ...] = (
    _policy("one bit of a weight", lambda f: flip_bit(f / WEIGHTS, 0.7)),
    _policy("one bit of the weights' header", lambda f: flip_bit(f / WEIGHTS, 0.0005)),
    _policy("weights cut", lambda f: cut(f / WEIGHTS, 0.9)),
    _policy("weights of another training", lambda f: change_tensors(f / WEIGHTS, other_numbers)),
    _policy("a weight that is NaN, saved so", lambda f: save_weights(f, made_nan)),
    _policy(
        "a tensor more, saved so",
        lambda f: save_weights(f, lambda tensors: tensors.update(more=torch.zeros(2))),
    ),
    _policy(
        "a tensor less, saved so", lambda f: save_weights(f, lambda tensors: tensors.popitem())
    ),
    _policy("another tactile tokenizer named, saved so", another_tokenizer),
    _policy(
        "config of another training",
        lambda f: edit_text(f / CONFIG, '"n_action_steps": 2', '"n_action_steps": 5'),
    ),
    _policy("config cut", lambda f: cut(f / CONFIG, 0.9)),
    _policy("no config", lambda f: (f / CONFIG).unlink()),
    _policy("a config that asks not to be verified", lambda f: save_config(f, verify="off")),
    _policy(
        "preprocessor of another training",
        lambda f: edit_text(f / PREPROCESSOR, "policy_preprocessor", "another_preprocessor"),
    ),
    _policy(
        "statistics of another training", lambda f: change_tensors(f / STATISTICS, other_numbers)
    ),
    _policy(
        "statistics linked to a tokenizer's weights",
        lambda f: link(f / STATISTICS, SMALL / TOKENIZER / WEIGHTS),
    ),
    _policy("no statistics", lambda f: (f / STATISTICS).unlink()),
    _policy("a state file more", lambda f: (f / "policy_more.safetensors").write_bytes(b"x")),
    _policy("card of another licence", lambda f: edit_text(f / CARD, "license: ", "license: not-")),
    _policy("scores changed", lambda f: flip_bit(f / "scores.json")),
    _policy(
        "hashes: one digit more", lambda f: edit_text(f / HASHES, '"sha256": "', '"sha256": "0')
    ),
    _policy(
        "hashes: a file outside the folder", lambda f: edit_text(f / HASHES, CONFIG, f"../{CONFIG}")
    ),
    _policy("hashes: none listed", lambda f: (f / HASHES).write_text("{}")),
    _policy("hashes: cut", lambda f: cut(f / HASHES, 0.9)),
    _tokenizer("one bit of a weight", lambda f: flip_bit(f / WEIGHTS, 0.7)),
    _tokenizer(
        "weights of the other size",
        lambda f: shutil.copyfile(NANO / TOKENIZER / WEIGHTS, f / WEIGHTS),
    ),
    _tokenizer("a weight that is NaN, saved so", lambda f: save_weights(f, made_nan)),
    _tokenizer("another canonicaliser, saved so", lambda f: save_config(f, canonicaliser={})),
    _head("one bit of a weight", lambda f: flip_bit(f / WEIGHTS, 0.7)),
    _head(
        "the other tokenizer's, whole",
        lambda f: shutil.copytree(NANO / "force_head_tactip", f, dirs_exist_ok=True),
    ),
)
