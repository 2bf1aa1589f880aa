"""Readers of files that others wrote: each writes a folder that is right, to be injured file by
file."""

import logging

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
from uniforce_vtla.tokenizer.force_head import ForceRegressor, HeadConfig
from uniforce_vtla.tokenizer.latent_map import LatentMap
from uniforce_vtla.tokenizer.weights import load_state, save_state

SMALL = TokenizerConfig(
    side=32, patch=8, width=16, depth=1, decoder_depth=1, heads=2, embed_hidden=0
)
HASH = "a" * 64


def open_target(name, root):
    """Write a target's folder; return what reads it, and its files."""
    read = FILE_TARGETS[name](root)
    if not name.startswith("hashes"):
        # they would refuse every injury before a reader meets it
        for hashes in root.rglob(HASHES):
            hashes.unlink()
    (root / ".recorder.lock").unlink(missing_ok=True)
    return read, sorted(path for path in root.rglob("*") if path.is_file() and path.stat().st_size)


def dataset(root):
    """Read a recording as uniforce view and uniforce show do: metadata, columns, every video."""
    logging.getLogger("lerobot").setLevel(logging.ERROR)
    record_synthetic(root, 1, 3)

    def read():
        source = check_dataset(root)
        source.columns((STATE, ACTION))
        for episode in source.episodes:
            for span in episode.videos.values():
                for _ in episode_frames(span, episode.length, source.fps):
                    pass
        write_pooled_stats(root)

    return read


def hashes_of_dataset(root):
    (root / "meta").mkdir(parents=True)
    (root / "meta" / "info.json").write_text("{}")
    dataset_hashes.write_hashes(root, {})
    return lambda: dataset_hashes.check_hashes(root)


def view(root):
    """Read a training view and two of its samples."""
    recorded = record_synthetic(root.parent / "recorded", 1, 3)
    build_view(recorded, root, image_side=8, encoder=BlockMeans())

    def read():
        samples = TrainingView(root, (-1, 0, 1))
        assert samples[0].keys() == samples[len(samples) - 1].keys()

    return read


def tokenizer(root):
    Tokenizer.random(SMALL).save(root)
    image = np.zeros((1, 48, 64), np.uint8)
    image[:, 10:20, 10:20] = 255
    return lambda: Tokenizer.from_pretrained(root).encode(image, image, "left")


def force_head(root):
    ForceHead(ForceRegressor(HeadConfig(hidden=4, mlp=8)), "tactip", HASH).save(root)
    return lambda: ForceHead.from_pretrained(path=root)


def adapter(root):
    judged = {"small": Agreement(9, (1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))}
    names = HASH, HASH, "new", "anchor"
    Calibration(LatentMap(16, 6).eval(), *names, 1.0, 0.0, judged).save(root)
    latent = Latent.of(torch.zeros(1, 16, 6), HASH)
    return lambda: Calibration.load(root, HASH)(latent)


def policy(root):
    """Read config, weights and processors of a tiny policy, as the scorer does."""
    stored = Tokenizer.random(SMALL).save(root.parent / "tokenizer")
    cameras = ("front", "wrist", "tactile_left", "tactile_right")
    config = small_config(cameras, touch=TouchSettings(input="latent", tokenizer_path=str(stored)))
    one = np.ones(5)
    spread = {"q01": -one, "q99": one, "mean": 0 * one, "std": one, "min": -one, "max": one}
    processors = make_processors(config, {STATE: spread, ACTION: spread})
    for part in (PI05UniforcePolicy(config), *processors):
        part.save_pretrained(root)
    return lambda: PolicyController(root, {})


def training_state(root):
    layer = torch.nn.Linear(3, 2)
    optimizer = torch.optim.AdamW(layer.parameters())
    layer(torch.ones(1, 3)).sum().backward()
    optimizer.step()
    root.mkdir()
    save_state(root, 7, layer.state_dict(), optimizer.state_dict())
    return lambda: load_state(root)


def hashes_of_checkpoint(root):
    root.mkdir()
    (root / "config.json").write_text("{}")
    write_hashes(root)
    return lambda: check_hashes(root, UniForceError)


def arrays(root):
    root.mkdir()
    np.save(root / "one.npy", np.arange(60.0).reshape(3, 4, 5))
    np.savez(root / "many.npz", a=np.arange(6), b=np.zeros((2, 3)))

    def read():
        read_array(root / "one.npy")
        read_arrays(root / "many.npz", ["a", "b"])

    return read


FILE_TARGETS = {  # the quick ones first
    "arrays": arrays,
    "hashes_of_dataset": hashes_of_dataset,
    "hashes_of_checkpoint": hashes_of_checkpoint,
    "training_state": training_state,
    "adapter": adapter,
    "force_head": force_head,
    "tokenizer": tokenizer,
    "view": view,
    "dataset": dataset,
    "policy": policy,
}
