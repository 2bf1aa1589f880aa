"""Policies of random weights and their inputs, for benches: time depends on shapes alone."""

import statistics
import time
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from typing import Annotated, Any
from unittest import mock

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.pi05.modeling_pi05 import PI05Pytorch

from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import (
    PI05UniforceConfig,
    TinySettings,
    TouchSettings,
)
from lerobot_policy_pi05_uniforce.modeling_pi05_uniforce import made_up_batch
from lerobot_policy_pi05_uniforce.network import Inputs, PI05UniforcePytorch
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import FOLDER
from lerobot_policy_pi05_uniforce.sampler.fast import FastSampler
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import ACTION, AXES, STATE
from uniforce_vtla.options import Names, Pattern

CAMERAS = ("base", "left_wrist", "right_wrist")
PROMPT = 50  # text tokens
SLOTS = {"touch0": "right", "touch1": "left"}
# of a flow at π0.5's shapes: depth, cameras, prompt, steps; a CPU needs seconds for it
MID: dict[str, Any] = {
    "tiny": TinySettings(width=256, depth=18, mlp_dim=1024),
    "image_resolution": (224, 224),
    "chunk_size": 50,
    "n_action_steps": 50,
    "max_action_dim": 32,
    "tokenizer_max_length": 200,
}
SIZES: dict[str, dict[str, Any]] = {
    "small": {"size": "tiny", "tiny": TinySettings(width=64, depth=2, mlp_dim=32)},  # for tests
    "tiny": {"size": "tiny"},
    "mid": {"size": "tiny"} | MID,
    "base": {"size": "base", "text_tokenizer_name": str(FOLDER)},  # π0.5, 3.4 B
}
Size = Annotated[str, Names(tuple(SIZES))]
Device = Annotated[str, Pattern("cpu | cuda", r"cpu|cuda(:\d)?", "cpu")]


def check_device(device: str) -> None:
    """Use one thread of a CPU; ContractError where a CUDA device is asked for and none is here."""
    torch.set_num_threads(1)
    if device.startswith("cuda") and not torch.cuda.is_available():
        raise ContractError(expected("device", "a CUDA device", "none here", "Use device=cpu."))


def build(size: str, device: str, dtype: str = "float32") -> PI05UniforcePolicy:
    """Return a policy of random weights, adaptive norms included, with two slots of touch."""
    torch.manual_seed(0)
    touch = TouchSettings(SLOTS, "latent", start_at_base=True)
    config = PI05UniforceConfig(device=device, touch=touch, **SIZES[size])
    if size == "base":
        config.dtype = dtype
    for camera in CAMERAS:
        shape = (3, *config.image_resolution)
        config.input_features[f"observation.images.{camera}"] = PolicyFeature(
            FeatureType.VISUAL, shape
        )
    config.input_features[STATE] = PolicyFeature(FeatureType.STATE, (len(AXES),))
    config.output_features = {ACTION: PolicyFeature(FeatureType.ACTION, (len(AXES),))}
    with torch.device(device):  # 3 B random numbers take a CPU a minute
        policy = PI05UniforcePolicy(config)
    for name, weight in policy.named_parameters():
        if "norm.dense.weight" in name:  # starts as zero: every norm would be the same
            torch.nn.init.normal_(weight, std=0.02)
    return policy.eval()


def sampler_of(network: PI05UniforcePytorch) -> FastSampler:
    assert network.fast is not None, "build() leaves sampler.kind at fast"
    return network.fast


@torch.no_grad()
def observe(policy: PI05UniforcePolicy, rows: int = 1) -> tuple[Inputs, torch.Tensor]:
    """Return the network's inputs for a batch, with touch, and starting noise."""
    config = policy.config
    device = policy.leash.device
    batch = {
        key: value.repeat_interleave(rows, dim=0)
        for key, value in made_up_batch(config, device).items()
    }
    for key in config.image_features:
        batch[key] = torch.rand_like(batch[key])
    images, there = policy._preprocess_images(batch)
    tokens = torch.randint(0, 50, (rows, config.tokenizer_max_length), device=device)
    mask = (torch.arange(config.tokenizer_max_length, device=device) < PROMPT).expand_as(tokens)
    noise = torch.randn(rows, config.chunk_size, config.max_action_dim, device=device)
    return Inputs(images, there, tokens, mask, policy.felt(batch)), noise


@contextmanager
def lerobots_layers(network: PI05UniforcePytorch) -> Any:
    """Run LeRobot's own layers in the small networks; base has no others."""
    with mock.patch.object(network.paligemma_with_expert, "fused", False, create=True):
        yield


def samplers(
    network: PI05UniforcePytorch, given: Inputs, noise: torch.Tensor, steps: int
) -> dict[str, Callable[[], torch.Tensor]]:
    """Return LeRobot 0.6.1's loop, the same with batched cameras in our dtype, and ours."""
    *seen, _ = given
    ours = Inputs(*seen)  # LeRobot's loop knows no touch

    def stock() -> torch.Tensor:
        with lerobots_layers(network):
            return PI05Pytorch.sample_actions(network, *seen, noise=noise, num_steps=steps)

    def batched() -> torch.Tensor:
        """As LeRobot's main since its change 4426."""
        prepared = sampler_of(network).prepared
        patches = prepared.tower(torch.cat(given.images).to(prepared.dtype)).last_hidden_state
        cameras = iter(prepared.projector(patches).chunk(len(given.images)))
        backbone = network.paligemma_with_expert
        with mock.patch.object(backbone, "embed_image", lambda _: next(cameras)):
            return stock()

    def fast() -> torch.Tensor:
        return network.sample_actions(*ours, noise=noise, num_steps=steps)

    return {"fast": fast, "stock": stock, "stock_batched": batched}


def milliseconds(call: Callable[[], Any], device: str) -> float:
    wait(device)
    start = time.perf_counter()
    call()
    wait(device)
    return 1000 * (time.perf_counter() - start)


def wait(device: str) -> None:
    if device.startswith("cuda"):
        torch.cuda.synchronize()


def in_turns(
    calls: Mapping[str, Callable[[], Any]], device: str, rounds: int
) -> dict[str, list[float]]:
    """Return times [ms] of calls that take turns, one round to warm up left out."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for number in range(rounds + 1):
        for name, call in calls.items():
            took_ms = milliseconds(call, device)
            if number:
                times[name].append(took_ms)
    return times


def ratio(first: list[float], second: list[float]) -> float:
    """Return the median over rounds of ratios within a round."""
    return statistics.median(a / b for a, b in zip(first, second, strict=True))
