"""Training steps with two slots of touch and without, in turns: samples per second and memory.

Random weights on random samples; the gate of ``start_at_base`` is on, and steps run LeRobot's own
layers, as ``base`` does.
"""

import importlib.util
import itertools
import statistics
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from benchmarks.policy.network import (
    Device,
    Size,
    build,
    check_device,
    lerobots_layers,
    milliseconds,
    observe,
    ratio,
)
from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.touch.tokens import Felt
from uniforce_cli.boundary import command
from uniforce_vtla.options import Count, OutFolder
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.weights import content_hash

TOUCH_MODULES = ("force_tokens", "touch_gate")
LEARNING_RATE = 2.5e-5  # peak of base
MODES = ("full", "lora")
BATCHES = (1, 4)


@dataclass
class TrainingSpeedConfig:
    """Time training steps, touch beside none in turns; write training.json.

    Example: python -m benchmarks.policy.training_speed device=cuda size=base
    """

    device: Device = "cpu"  # cpu (one thread) | cuda
    size: Size = "tiny"  # base is in bfloat16
    rounds: Count = 5  # a step of each kind per round
    out: OutFolder = "outputs/bench_policy"  # training.json


def rows(config: TrainingSpeedConfig) -> list[dict[str, Any]]:
    """Return a row per mode, checkpointing and batch; ContractError: no CUDA device here."""
    check_device(config.device)
    found: list[dict[str, Any]] = []
    for mode in MODES:
        if mode == "lora" and importlib.util.find_spec("peft") is None:
            found.append({"mode": mode, "not run": "peft isn't installed"})
            continue
        policy = build(config.size, config.device, "bfloat16")
        if mode == "lora":
            policy.config.pretrained_path = Path("random weights")
            policy.wrap_with_peft(peft_cli_overrides={"method_type": "LORA", "r": 16})
        policy.train()
        for is_checkpointed, batch in itertools.product((False, True), BATCHES):
            policy.model.gradient_checkpointing_enabled = is_checkpointed
            if is_checkpointed:
                policy.model.gradient_checkpointing_enable()
            row = {"mode": mode, "checkpointing": is_checkpointed, "batch": batch}
            found.append(row | steps_of(policy, batch, config))
    return found


def steps_of(
    policy: PI05UniforcePolicy,
    batch: int,
    config: TrainingSpeedConfig,
    learning_rate: float = LEARNING_RATE,
) -> dict[str, Any]:
    """Return samples per second and peak memory of both, losses, and touch's gradient norms."""
    network = policy.model
    given, noise = observe(policy, batch)
    learnt = [p for p in policy.parameters() if p.requires_grad]
    optimizer = torch.optim.AdamW(learnt, lr=learning_rate)
    inputs = {"touch": given, "stock": given._replace(felt=Felt(given.felt.state))}
    times: dict[str, list[float]] = {name: [] for name in inputs}
    losses: dict[str, list[float]] = {name: [] for name in inputs}
    norms: dict[str, list[float]] = {name: [] for name in TOUCH_MODULES}
    peak_GiB = dict.fromkeys(inputs, float("nan"))
    time = noise.new_full((batch,), 0.5)
    flow = {"actions": torch.zeros_like(noise), "noise": noise, "time": time}
    before = tokenizer_hash(policy)

    def step(name: str) -> None:
        optimizer.zero_grad()
        with lerobots_layers(network):
            loss = network.forward(*inputs[name], **flow).mean()
            loss.backward()
        optimizer.step()
        losses[name].append(float(loss.detach()))

    for number in range(config.rounds + 1):  # the first to warm up
        for name in inputs:
            if config.device.startswith("cuda"):
                torch.cuda.reset_peak_memory_stats()
            took_ms = milliseconds(partial(step, name), config.device)
            if config.device.startswith("cuda"):
                peak_GiB[name] = torch.cuda.max_memory_allocated() / 2**30
            if number:
                times[name].append(took_ms)
            if name == "touch":
                for module, found in norms.items():
                    weights = getattr(network, module).parameters()
                    grads = [p.grad for p in weights if p.grad is not None]
                    found.append(float(torch.nn.utils.get_total_norm(grads)))
    return {
        "samples_per_s": {n: 1000 * batch / statistics.median(v) for n, v in times.items()},
        "touch_over_stock": ratio(times["stock"], times["touch"]),
        "peak_GiB": peak_GiB,
        "losses": losses,
        "gradient_norms": norms,
        "tokenizer_unchanged": tokenizer_hash(policy) == before,
    }


def tokenizer_hash(policy: PI05UniforcePolicy) -> str:
    """Return the content hash of the frozen tokenizer inside a policy."""
    facts = dict(policy.config.touch.tokenizer or {})
    facts.pop("hash", None)
    return content_hash(policy.model.tactile_encoder.model, facts)


@command(TrainingSpeedConfig)
def main(config: TrainingSpeedConfig) -> None:
    found = rows(config)
    content = {"size": config.size, "rows": found}
    path = write_json(Path(config.out) / "training.json", content | provenance())
    for row in found:
        print({name: row[name] for name in row if name not in ("losses", "gradient_norms")})
    print(f"written to {path}")


if __name__ == "__main__":
    sys.exit(main())
