"""Goldens: the shipped policy, tokenizer and head give what they gave before the chain of touch was
rewritten.

They are keyed by the hashes of the shipped checkpoints. UNIFORCE_WRITE_GOLDENS=1 writes them anew,
after a checkpoint was replaced on purpose.
"""

import os
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from benchmarks.real.films import film_frames
from lerobot_policy_pi05_uniforce.controller import PolicyController, shipped_checkpoint
from lerobot_policy_pi05_uniforce.modeling_pi05_uniforce import PI05UniforcePolicy, made_up_batch
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.source import episode_frames
from uniforce_datasets.synthetic import record_synthetic
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import SensorError
from uniforce_vtla.keys import ACTION, AXES, CAMERAS, STATE, tactile_name
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.tokenizer import ForceHead, Tokenizer, pool_latent
from uniforce_vtla.tokenizer.calibration import Agreement, Calibration
from uniforce_vtla.tokenizer.latent_map import LatentMap

FOLDER = Path(__file__).parent
EXPECTED = FOLDER / "expected.npz"
WRITES = bool(os.environ.get("UNIFORCE_WRITE_GOLDENS"))
FILMS = Path(__file__).parents[2].parent / "shared" / "real" / "gelsight_mini_grasps"
SENSORS = ["tactip"] * 12 + ["uskin"] * 4 + ["gelsight"] * 4  # of the scenes in observed.npz
# three times at rest: the monitor judges free air by them
LOOKS = (0, 0, 0, 1, 2)
REAL_FRAMES = (40, 80, 120, 160)  # of each film
# float32 is rounded in another order on another processor; on one machine 1e-6 holds
TOLERANCE = float(os.environ.get("UNIFORCE_GOLDEN_TOLERANCE", 1e-5))


def same(name, found):
    """Compare with the golden of that name, or write it."""
    stored = dict(np.load(EXPECTED)) if EXPECTED.is_file() else {}
    if WRITES:
        np.savez_compressed(EXPECTED, **stored | {name: found})
        return
    np.testing.assert_allclose(found, stored[name], rtol=TOLERANCE, atol=TOLERANCE)


@pytest.fixture(scope="module")
def observed():
    stored = dict(np.load(FOLDER / "observed.npz"))
    stored["marker"] = np.unpackbits(stored["marker"], axis=-1) * np.uint8(255)
    return stored


@pytest.fixture(scope="module")
def tokenizer():
    return Tokenizer.from_pretrained()


@pytest.fixture(scope="module")
def head():
    return ForceHead.from_pretrained()


@pytest.fixture(scope="module")
def calibrated(tokenizer, head, tmp_path_factory):
    """The folder of a made-up calibration of a GelSight."""
    generator = torch.Generator().manual_seed(5)
    latent_map = LatentMap(16, tokenizer.config.latent)
    latent_map.weight.copy_(0.01 * torch.randn(latent_map.weight.shape, generator=generator))
    latent_map.shift.copy_(0.05 * torch.randn(latent_map.shift.shape, generator=generator))
    agreement = Agreement(20, (0.9, 0.95, 0.8), (0.95, 0.97, 0.9), (0.8, 0.8, 0.6))
    names = ("gelsight:3", "tactip:1", 0.1, 0.0)
    judged = {"small": agreement, "tool": agreement}
    found = Calibration(latent_map, tokenizer.hash, head.hash, *names, judged)
    return str(found.save(tmp_path_factory.mktemp("goldens") / "calibration"))


def observation(observed, scene, moment):
    """Return an environment's observation."""
    pixels = dict(zip(CAMERAS, observed["camera"][scene, moment], strict=True))
    for finger, images in zip(FINGERS, observed["marker"][scene, moment], strict=True):
        for is_reference, image in zip((True, False), images, strict=True):
            pixels[tactile_name(finger, is_reference)] = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    return {"pixels": pixels, "agent_pos": observed["state"][scene, moment].astype(np.float32)}


def test_the_goldens_are_of_the_shipped_checkpoints(tokenizer, head):
    config = PI05UniforcePolicy.config_class.from_pretrained(shipped_checkpoint())
    hashes = [tokenizer.hash, head.hash, config.tokenizer_hash]
    digits = np.array([[int(digit, 16) for digit in name] for name in hashes])
    same("hashes", digits)


@pytest.mark.parametrize("kind", ["tactip", "uskin", "gelsight"])
def test_actions(kind, observed, calibrated):
    scenes = [number for number, sensor in enumerate(SENSORS) if sensor == kind]
    mounted = {"left": "gelsight", "right": kind}
    folder = calibrated if kind == "gelsight" else ""
    controller = PolicyController(
        shipped_checkpoint(),
        mounted,
        asked={"right": kind},
        calibrations={"right": folder},
        monitor="off" if folder else "stop",
    )
    actions = []
    for scene in scenes:
        controller.reset(env=None)
        for moment in LOOKS:
            seen = observation(observed, scene, moment)
            actions.append(controller.chunk(seen, "wipe the word off the board with the eraser"))
    same(f"actions_{kind}", np.array(actions))


def same_touch(prefix, latents, head):
    """Compare pooled latents and newtons of (1, P, L) latents."""
    same(f"{prefix}latents", np.array([pool_latent(latent)[0].numpy() for latent in latents]))
    same(f"{prefix}newtons", np.array([head(latent)[0].numpy() for latent in latents]))


def test_latents_and_newtons_of_simulated_frames(observed, tokenizer, head):
    latents = []
    for scene in range(20):
        for moment in range(3):
            reference, current = observed["marker"][scene, moment, 1]
            latents.append(tokenizer.encode(reference[None], current[None], "right"))
    same_touch("", latents, head)


def test_latents_and_newtons_of_real_frames(tokenizer, head):
    if not FILMS.is_dir():
        pytest.skip(f"no real recordings at {FILMS}")
    latents, shown = [], []
    for path in sorted(FILMS.glob("*/exp_num_1/camera_0.avi"))[:10]:
        frames = list(film_frames(path))
        canonicalizer = Canonicalizer("gelsight")
        for number in REAL_FRAMES:
            try:
                pair = canonicalizer.pair(frames[0], frames[number % len(frames)], "left")
            except SensorError:
                continue
            latents.append(tokenizer.encode(pair))
            shown.append(cv2.resize(pair.current, (8, 6), interpolation=cv2.INTER_AREA))
    assert len(latents) >= 20
    same("real_markers", np.array(shown))
    same_touch("real_", latents, head)


def drawn(name, *shape):
    """Return numbers from 0 to 1 that depend on a name alone."""
    generator = torch.Generator().manual_seed(zlib.crc32(name.encode()))
    return torch.rand(shape, generator=generator)


def test_the_loss_of_a_training_step():
    policy = PI05UniforcePolicy.from_pretrained(shipped_checkpoint(), warm=False)
    batch = made_up_batch(policy.config, torch.device("cpu"))
    for key, value in batch.items():
        if value.is_floating_point():
            noise = drawn(key, *value.shape)
            # marker images are black and white
            batch[key] = (noise > 0.9).float() if "tactile" in key else 0.3 * noise
    batch[ACTION] = 0.01 * drawn(ACTION, 1, len(policy.config.action_delta_indices), len(AXES))
    torch.manual_seed(1)
    policy.train()
    loss, _ = policy.forward(batch)
    same("loss", loss.detach().numpy())


def test_a_recorded_episode(tmp_path):
    source = check_dataset(record_synthetic(tmp_path / "demos", episodes=1, frames=12))
    episode = source.episodes[0]
    columns = source.columns((STATE, ACTION))
    same("recorded_state", columns[STATE])
    same("recorded_action", columns[ACTION])
    for key, span in sorted(episode.videos.items()):
        frames = np.stack(list(episode_frames(span, episode.length, source.fps)))
        small = [cv2.resize(frame, (8, 6), interpolation=cv2.INTER_AREA) for frame in frames]
        same(f"recorded_{key}", np.array(small))
