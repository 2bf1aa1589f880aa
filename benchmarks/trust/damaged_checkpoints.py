"""Damages of shipped checkpoints, each tried on a copy: every one must be refused at load."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file

from lerobot_policy_pi05_uniforce.controller import PolicyController, shipped_checkpoint
from uniforce_vtla.errors import UniForceError
from uniforce_vtla.file_hashes import HASHES, write_hashes
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.descriptor_head import SCENE, SHIPPED, DescriptorHead
from uniforce_vtla.tokenizer.weights import ASSETS

CONFIG, WEIGHTS, CARD = "config.json", "model.safetensors", "README.md"
PREPROCESSOR = "policy_preprocessor.json"
STATISTICS = "policy_preprocessor_step_3_normalizer_processor.safetensors"

Tensors = dict[str, torch.Tensor]
Damage = Callable[[Path], object]


@dataclass(frozen=True)
class CheckpointDamage:
    """One way to damage a checkpoint."""

    name: str  # what is damaged, in words
    damage: Damage  # does it to a folder
    sound: Path  # the shipped folder that is copied
    load: Callable[[Path], object]  # loads a folder as a user would

    def refused(self, folder: Path) -> str | None:
        """Damage and load a copy inside ``folder``; return the error's line, None if it was accepted."""
        copy = folder / self.sound.name
        shutil.copytree(self.sound, copy)
        self.damage(copy)
        try:
            self.load(copy)
        except UniForceError as error:
            return str(error)
        return None


def flipped(name: str, place: float) -> Damage:
    """Flip one bit of a file at a share of its length."""

    def damage(folder: Path) -> None:
        content = bytearray((folder / name).read_bytes())
        content[int(place * (len(content) - 1))] ^= 1
        (folder / name).write_bytes(content)

    return damage


def cut(name: str, share: float = 0.9) -> Damage:
    """Keep the first part of a file."""
    return lambda folder: (folder / name).write_bytes(_head(folder / name, share))


def replaced(name: str, other: Path) -> Damage:
    """Take a file from another checkpoint."""
    return lambda folder: shutil.copyfile(other / name, folder / name)


def linked(name: str, target: Path) -> Damage:
    """Let a file be a link to another one."""

    def damage(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).symlink_to(target)

    return damage


def removed(name: str) -> Damage:
    """Delete a file."""
    return lambda folder: (folder / name).unlink()


def edited(name: str, old: str, new: str) -> Damage:
    """Put another text in place of one that is there."""

    def damage(folder: Path) -> None:
        text = (folder / name).read_text()
        if old not in text:
            raise ValueError(f"{name} holds no {old!r}")
        (folder / name).write_text(text.replace(old, new, 1))

    return damage


def changed(name: str, change: Callable[[Tensors], object]) -> Damage:
    """Change the tensors of a file; its hash stays the old one."""

    def damage(folder: Path) -> None:
        tensors = load_file(folder / name)
        change(tensors)
        save_file(tensors, folder / name)

    return damage


def with_tensors(change: Callable[[Tensors], object]) -> Damage:
    """Change the weights and write the hashes again, as a careless saving would."""

    def damage(folder: Path) -> None:
        changed(WEIGHTS, change)(folder)
        write_hashes(folder)

    return damage


def other_numbers(tensors: Tensors) -> None:
    """Give one tensor the numbers another training would."""
    next(tensor for tensor in tensors.values() if tensor.is_floating_point()).add_(0.01)


def made_nan(tensors: Tensors) -> None:
    """Make one number of one tensor NaN."""
    next(iter(tensors.values())).view(-1)[0] = torch.nan


def set_in_config(**settings: object) -> Damage:
    """Change settings and write the hashes again."""

    def damage(folder: Path) -> None:
        stored = json.loads((folder / CONFIG).read_text())
        (folder / CONFIG).write_text(json.dumps(stored | settings))
        write_hashes(folder)

    return damage


def another_tokenizer(folder: Path) -> None:
    """Name another tactile tokenizer in the config and write the hashes again."""
    touch = json.loads((folder / CONFIG).read_text())["touch"]
    touch["tokenizer"]["hash"] = "0" * 64
    set_in_config(touch=touch)(folder)


def _head(path: Path, share: float) -> bytes:
    content = path.read_bytes()
    return content[: int(share * len(content))]


def _load_policy(folder: Path) -> None:
    PolicyController(folder, {})


def _read_force(folder: Path) -> None:
    """Read force with the head in ``folder`` through the default tokenizer."""
    image = np.zeros((1, 96, 128), np.uint8)
    image[:, 40:56, 40:56] = 255
    ForceHead.from_pretrained(path=folder)(Tokenizer.from_pretrained().encode(image, image))


def _load_descriptor_head(folder: Path) -> None:
    DescriptorHead.from_pretrained(folder.name, folder.parent)


def _policy(name: str, damage: Damage) -> CheckpointDamage:
    return CheckpointDamage(f"policy: {name}", damage, shipped_checkpoint(), _load_policy)


def _tokenizer(name: str, damage: Damage) -> CheckpointDamage:
    sound = ASSETS / "small" / "tokenizer"
    return CheckpointDamage(f"tokenizer: {name}", damage, sound, Tokenizer.from_pretrained)


def _head_of(name: str, damage: Damage) -> CheckpointDamage:
    return CheckpointDamage(f"force head: {name}", damage, ASSETS / "small" / "force_head_tactip", _read_force)


CHECKPOINT_DAMAGES: tuple[CheckpointDamage, ...] = (
    _policy("one bit of a weight", flipped(WEIGHTS, 0.7)),
    _policy("one bit of the weights' header", flipped(WEIGHTS, 0.0005)),
    _policy("weights cut", cut(WEIGHTS)),
    _policy("weights of another training", changed(WEIGHTS, other_numbers)),
    _policy("a weight that is NaN, saved so", with_tensors(made_nan)),
    _policy("a tensor more, saved so", with_tensors(lambda tensors: tensors.update(more=torch.zeros(2)))),
    _policy("a tensor less, saved so", with_tensors(lambda tensors: tensors.popitem())),
    _policy("another tactile tokenizer named, saved so", another_tokenizer),
    _policy("config of another training", edited(CONFIG, '"n_action_steps": 2', '"n_action_steps": 5')),
    _policy("config cut", cut(CONFIG)),
    _policy("no config", removed(CONFIG)),
    _policy("a config that asks not to be verified", set_in_config(verify="off")),
    _policy("preprocessor of another training", edited(PREPROCESSOR, "policy_preprocessor", "another_preprocessor")),
    _policy("statistics of another training", changed(STATISTICS, other_numbers)),
    _policy("statistics linked to a tokenizer's weights", linked(STATISTICS, ASSETS / "small" / "tokenizer" / WEIGHTS)),
    _policy("no statistics", removed(STATISTICS)),
    _policy("a state file more", lambda folder: (folder / "policy_more.safetensors").write_bytes(b"x")),
    _policy("card of another licence", edited(CARD, "license: ", "license: not-")),
    _policy("scores changed", flipped("scores.json", 0.5)),
    _policy("hashes: one digit more", edited(HASHES, '"sha256": "', '"sha256": "0')),
    _policy("hashes: a file outside the folder", edited(HASHES, CONFIG, f"../{CONFIG}")),
    _policy("hashes: none listed", lambda folder: (folder / HASHES).write_text("{}")),
    _policy("hashes: cut", cut(HASHES)),
    _tokenizer("one bit of a weight", flipped(WEIGHTS, 0.7)),
    _tokenizer("weights of the other size", replaced(WEIGHTS, ASSETS / "nano" / "tokenizer")),
    _tokenizer("a weight that is NaN, saved so", with_tensors(made_nan)),
    _tokenizer("another canonicaliser, saved so", set_in_config(canonicaliser={})),
    _head_of("one bit of a weight", flipped(WEIGHTS, 0.7)),
    _head_of(
        "the other tokenizer's, whole",
        lambda folder: shutil.copytree(ASSETS / "nano" / "force_head_tactip", folder, dirs_exist_ok=True),
    ),
    CheckpointDamage(
        "descriptor head: of another sensor, saved so",
        set_in_config(sensor="gelsight"),
        SHIPPED / f"descriptor_heads_{SCENE}" / "tactip",
        _load_descriptor_head,
    ),
)
