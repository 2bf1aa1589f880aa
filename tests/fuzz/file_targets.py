"""Readers of files that others wrote: each with a folder that is right, to be injured file by file."""

import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from policy_samples import small_config

from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce import make_pi05_uniforce_pre_post_processors as make_processors
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import TouchSettings
from lerobot_policy_pi05_uniforce.controller import PolicyController
from uniforce_datasets import hashes as dataset_hashes
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.pooled_quantiles import write_pooled_stats
from uniforce_datasets.source import episode_frames
from uniforce_datasets.synthetic import BlockMeans, record_synthetic
from uniforce_datasets.training_view import TrainingView, build_view
from uniforce_vtla.array_file import read_array, read_arrays
from uniforce_vtla.errors import UniForceError
from uniforce_vtla.file_hashes import HASHES, check_hashes, write_hashes
from uniforce_vtla.keys import ACTION, STATE
from uniforce_vtla.tokenizer import ForceHead, Latent, Tokenizer, TokenizerConfig
from uniforce_vtla.tokenizer.calibration import Agreement, Calibration
from uniforce_vtla.tokenizer.descriptor import DESCRIPTOR_NAMES
from uniforce_vtla.tokenizer.descriptor_head import DescriptorHead
from uniforce_vtla.tokenizer.force_head import ForceRegressor, HeadConfig
from uniforce_vtla.tokenizer.latent_map import LatentMap
from uniforce_vtla.tokenizer.weights import load_state, save_state

TYPED = (UniForceError,)
SMALL = TokenizerConfig(
    side=32, patch=8, width=16, depth=1, decoder_depth=1, heads=2, embed_hidden=0
)
HASH = "a" * 64


@dataclass(frozen=True)
class FileTarget:
    folder: Path
    read: Callable[[], Any]
    typed: tuple[type[Exception], ...] = TYPED

    def __post_init__(self):
        # they would refuse every injury before a reader meets it
        for hashes in self.folder.rglob(HASHES):
            hashes.unlink()

    @property
    def files(self):
        return sorted(
            path for path in self.folder.rglob("*") if path.is_file() and path.stat().st_size
        )


def dataset(folder):
    """Read a recording as uniforce view and uniforce show do: metadata, columns, every video."""
    logging.getLogger("lerobot").setLevel(logging.ERROR)
    root = record_synthetic(folder / "data", 1, 3)
    (root / ".recorder.lock").unlink(missing_ok=True)
    (root / HASHES).unlink()  # or none of the readers behind them would see an injured file

    def read():
        source = check_dataset(root)
        source.columns((STATE, ACTION))
        for episode in source.episodes:
            for span in episode.videos.values():
                for _ in episode_frames(span, episode.length, source.fps):
                    pass
        write_pooled_stats(root)

    return FileTarget(root, read)


def hashes_of_dataset(folder):
    root = folder / "data"
    (root / "meta").mkdir(parents=True)
    (root / "meta" / "info.json").write_text("{}")
    target = FileTarget(root, lambda: dataset_hashes.check_hashes(root))
    dataset_hashes.write_hashes(root, {})
    return target


def view(folder):
    """Read a training view and two of its samples."""
    recorded = record_synthetic(folder / "recorded", 1, 3)
    root = build_view(recorded, folder / "data", image_side=8, encoder=BlockMeans())
    (root / HASHES).unlink()

    def read():
        samples = TrainingView(root, (-1, 0, 1))
        assert samples[0].keys() == samples[len(samples) - 1].keys()

    return FileTarget(root, read)


def tokenizer(folder):
    root = Tokenizer.random(SMALL).save(folder / "data")
    image = np.zeros((48, 64), np.uint8)
    image[10:20, 10:20] = 255
    return FileTarget(
        root, lambda: Tokenizer.from_pretrained(root).encode(image[None], image[None], "left")
    )


def force_head(folder):
    config = HeadConfig(hidden=4, mlp=8)
    root = ForceHead(ForceRegressor(config), "tactip", HASH).save(folder / "data")
    return FileTarget(root, lambda: ForceHead.from_pretrained(path=root))


def descriptor_head(folder):
    config = HeadConfig(channels=len(DESCRIPTOR_NAMES), grid=1, hidden=4, mlp=8)
    DescriptorHead(ForceRegressor(config), "tactip").save(folder / "data")
    seen = np.zeros((2, len(DESCRIPTOR_NAMES)))
    return FileTarget(
        folder / "data",
        lambda: DescriptorHead.from_pretrained("tactip", folder / "data").read(seen),
    )


def adapter(folder):
    judged = {"small": Agreement(9, (1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))}
    root = Calibration(LatentMap(16, 6).eval(), HASH, HASH, "new", "anchor", 1.0, 0.0, judged).save(
        folder / "data"
    )
    return FileTarget(
        root, lambda: Calibration.load(root, HASH)(Latent.of(torch.zeros(1, 16, 6), HASH))
    )


def policy(folder):
    """Read config, weights and processors of a tiny policy, as the scorer does."""
    stored = Tokenizer.random(SMALL).save(folder / "tokenizer")
    cameras = ("front", "wrist", "tactile_left", "tactile_right")
    config = small_config(cameras, touch=TouchSettings(input="latent", tokenizer_path=str(stored)))
    one = {name: np.full(5, value) for name, value in (("q01", -1.0), ("q99", 1.0), ("mean", 0.0))}
    stats = {
        key: one | {"std": np.ones(5), "min": -np.ones(5), "max": np.ones(5)}
        for key in (STATE, ACTION)
    }
    root = folder / "data"
    parts = (PI05UniforcePolicy(config), *make_processors(config, stats))
    for part in parts:
        part.save_pretrained(root)
    return FileTarget(root, lambda: PolicyController(root, {}))


def training_state(folder):
    layer = torch.nn.Linear(3, 2)
    optimizer = torch.optim.AdamW(layer.parameters())
    layer(torch.ones(1, 3)).sum().backward()
    optimizer.step()
    (folder / "data").mkdir()
    save_state(folder / "data", 7, layer.state_dict(), optimizer.state_dict())
    return FileTarget(folder / "data", lambda: load_state(folder / "data"))


def hashes_of_checkpoint(folder):
    (folder / "data").mkdir()
    (folder / "data" / "config.json").write_text("{}")
    target = FileTarget(folder / "data", lambda: check_hashes(folder / "data", UniForceError))
    write_hashes(folder / "data")
    return target


def arrays(folder):
    root = folder / "data"
    root.mkdir()
    np.save(root / "one.npy", np.arange(60.0).reshape(3, 4, 5))
    np.savez(root / "many.npz", a=np.arange(6), b=np.zeros((2, 3)))

    def read():
        read_array(root / "one.npy")
        read_arrays(root / "many.npz", ["a", "b"])

    return FileTarget(root, read)


FILE_TARGETS = {  # the quick ones first
    "arrays": arrays,
    "hashes_of_dataset": hashes_of_dataset,
    "hashes_of_checkpoint": hashes_of_checkpoint,
    "training_state": training_state,
    "adapter": adapter,
    "descriptor_head": descriptor_head,
    "force_head": force_head,
    "tokenizer": tokenizer,
    "view": view,
    "dataset": dataset,
    "policy": policy,
}


def is_json(data):
    """Whether values inside can be injured, and not only bytes."""
    try:
        json.loads(data)
    except ValueError:
        return False
    return True
