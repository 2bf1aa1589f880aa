"""Shared by tests of the policy's network: its inputs, norms that do something, LeRobot's own loop
beside ours."""

from unittest.mock import patch

import torch
from calibration_samples import save_shift
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.pi05 import modeling_pi05 as stock
from lerobot.utils.constants import OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS

from lerobot_policy_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import TinySettings
from lerobot_policy_pi05_uniforce.network import Inputs
from uniforce_vtla.keys import tactile_key
from uniforce_vtla.tokenizer.calibration import Agreement
from uniforce_vtla.tokenizer.latent_map import LatentMap
from uniforce_vtla.tokenizer.latent_range import FREE_LOOKS, HealthMonitor, LatentRange

OPEN = [0.6, 1.5]  # gates of two slots


def small_config(cameras=("front", "wrist"), **settings):
    """Settings of a policy of two layers with cameras of 28 px, state and action of five axes."""
    picture = PolicyFeature(FeatureType.VISUAL, (3, 28, 28))
    visual = {f"observation.images.{name}": picture for name in cameras}
    usual = {
        "size": "tiny",
        "device": "cpu",
        "image_resolution": (28, 28),
        "tiny": TinySettings(width=64, depth=2, mlp_dim=32),
        "input_features": visual | {"observation.state": PolicyFeature(FeatureType.STATE, (5,))},
        "output_features": {"action": PolicyFeature(FeatureType.ACTION, (5,))},
    }
    return PI05UniforceConfig(**usual | settings)


def inputs(policy, batch):
    images, masks = policy._preprocess_images(batch)
    text = batch[OBS_LANGUAGE_TOKENS], batch[OBS_LANGUAGE_ATTENTION_MASK]
    return Inputs(images, masks, *text, policy.felt(batch))


def start_noise(policy, size=2):
    return torch.randn(size, policy.config.chunk_size, policy.config.max_action_dim)


def alive(policy, gate=None, std=0.3):
    """Let the adaptive norms do something (they start as zeros, which shut the expert); open the
    gate if asked."""
    generator = torch.Generator().manual_seed(1)
    for name, p in policy.named_parameters():
        if "norm.dense.weight" in name:
            p.data = std * torch.randn(p.shape, generator=generator)
    if gate is not None:
        policy.model.touch_gate.gate.data[:] = torch.tensor(gate)
    return policy


def lerobots_own(policy, given, noise, steps=4, **rtc):
    """Sample with LeRobot's loop and LeRobot's layers: nothing of ours but the weights and the
    extra tokens."""
    *seen, felt = given
    network, how = policy.model, {"noise": noise, "num_steps": steps, **rtc}
    # the training path of the tiny network is ours
    with patch.object(network.paligemma_with_expert, "fused", False), network.feeling(felt):
        return stock.PI05Pytorch.sample_actions(network, *seen, **how)


def ours(policy, given, noise, steps=4, **rtc):
    return policy.model.sample_actions(*given, noise=noise, num_steps=steps, **rtc)


def watched(policy, limit=1e-3):
    """A policy whose right sensor is watched so closely that nothing is healthy."""
    usual = LatentRange("tactip", policy.config.tokenizer_hash, 96, limit, limit)
    policy.touch.sensors["touch0"].monitor = HealthMonitor(usual, "right", FREE_LOOKS)
    return policy


def with_dots(batch):
    """Marker images that show markers: a grid per finger, moved by a pixel or two in the current
    frame."""
    shown = dict(batch)
    for index, finger in enumerate(("left", "right")):
        grid = torch.zeros(len(batch[tactile_key(finger)]), 3, 48, 64)
        for row in range(4, 40, 8):
            for column in range(4, 56, 8 + index):
                grid[..., row : row + 3, column : column + 3] = 1
        shown[tactile_key(finger, True)] = grid
        shown[tactile_key(finger)] = grid.roll((1 + index, 2), dims=(-2, -1))
    return shown


JUDGED = {"tool": Agreement(9, (1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))}


def calibrate(folder, config, shift=0.0, new="tactip:7", anchor="tactip:7", **hashes):
    """Save a calibration for a policy whose map adds ``shift``; return its folder."""
    found = LatentMap(config.tokens_per_slot, config.latent_size)
    tokenizer_hash = hashes.get("tokenizer_hash", config.tokenizer_hash)
    head_hash = hashes.get("head_hash", config.touch.head_hash)
    names = (tokenizer_hash, head_hash, new, anchor)
    return save_shift(folder, found, shift, *names, judged=JUDGED)
