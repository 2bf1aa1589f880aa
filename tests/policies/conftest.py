import os
import signal
import subprocess
from contextlib import suppress

import numpy as np
import psutil
import pytest
import torch
from policy_samples import small_config

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy
from lerobot_policy_pi05_uniforce import make_pi05_uniforce_pre_post_processors as make_processors
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import READ_BY_HEAD
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig

SMALL = {"tiny__width": 64, "tiny__depth": 2, "tiny__mlp_dim": 32}
BOTH = {"touch0": "right", "touch1": "left"}
LOW, HIGH = np.array([0.3, -0.2, 0.0, -1.0, 0.0]), np.array([0.7, 0.2, 0.3, 1.0, 0.08])


@pytest.fixture(autouse=True)
def one_thread_seeded():
    torch.set_num_threads(1)
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def tokenizer_path(tmp_path_factory):
    config = TokenizerConfig(
        side=64, patch=8, width=16, depth=1, decoder_depth=1, heads=2, embed_hidden=0
    )
    return Tokenizer.random(config).save(tmp_path_factory.mktemp("tokenizer"))


@pytest.fixture(scope="session")
def stats():
    one = {"q01": LOW, "q99": HIGH, "min": LOW, "max": HIGH}
    one |= {"mean": (LOW + HIGH) / 2, "std": (HIGH - LOW) / 4}
    return {"observation.state": one, "action": one}


@pytest.fixture
def make_config(tokenizer_path):
    def make(**settings):
        touch = {"touch__slots": BOTH, "touch__input": "latent"}
        # only the shipped tokenizers have a head
        if settings.get("touch__input") not in READ_BY_HEAD:
            touch["touch__tokenizer_path"] = str(tokenizer_path)
        cameras = ("front", "wrist", "tactile_left", "tactile_right")
        return small_config(cameras, **in_groups(touch | SMALL | settings))

    return make


def in_groups(settings):
    """``touch__input="wrench"`` → ``touch=TouchSettings(input="wrench")``."""
    groups = {}
    plain = {name: value for name, value in settings.items() if "__" not in name}
    for name, value in settings.items():
        group, _, setting = name.partition("__")
        if setting:
            groups.setdefault(group, {})[setting] = value
    fields = PI05UniforceConfig.__dataclass_fields__
    return plain | {
        group: fields[group].default_factory(**values) for group, values in groups.items()
    }


@pytest.fixture
def make_policy(make_config):
    return lambda **settings: PI05UniforcePolicy(make_config(**settings)).eval()


@pytest.fixture
def make_batch(stats):
    """A preprocessed batch for a policy: cameras, state, marker images, wrenches, text; actions on request."""

    def make(policy, size=2, actions=False):
        before, _ = make_processors(policy.config, stats)
        batch = {"task": ["wipe the ink off the board"] * size}
        for name in ("front", "wrist"):
            batch[f"observation.images.{name}"] = torch.rand(size, 3, 28, 28)
        for finger in ("left", "right"):
            for suffix in ("", "_ref"):
                markers = (torch.rand(size, 1, 48, 64) > 0.9).float().expand(-1, 3, -1, -1)
                batch[f"observation.images.tactile_{finger}{suffix}"] = markers.contiguous()
        for slot in ("touch0", "touch1"):
            batch[f"observation.wrench.{slot}"] = torch.randn(size, 4) * 5
        batch["observation.state"] = _between(torch.rand(size, 5))
        if actions:
            steps = len(policy.config.action_delta_indices)
            batch["action"] = _between(torch.rand(size, steps, 5))
            batch["action_is_pad"] = torch.zeros(size, steps, dtype=torch.bool)
        return before(batch)

    return make


def _between(share):
    low, high = (torch.tensor(x, dtype=torch.float32) for x in (LOW, HIGH))
    return low + (high - low) * share


@pytest.fixture(scope="session")
def run_to_the_end():
    return _run_to_the_end


def _run_to_the_end(call, env, log, seconds):
    """Return what a program and its children said; one that hangs or fails shows it."""
    with log.open("w") as out:
        program = subprocess.Popen(call, env=env, stdout=out, stderr=out, start_new_session=True)
        try:
            code = program.wait(seconds)
        except subprocess.TimeoutExpired:
            code = None
        finally:
            _kill_all(program.pid)
            program.wait()
    said = log.read_text()
    assert code == 0, f"exit {code} (None: still running after {seconds} s)\n{said[-4000:]}"
    return said


def _kill_all(pid):
    """Kill a program, its group and its children: torchrun's are in sessions of their own, out of a group's reach."""
    children = psutil.Process(pid).children(recursive=True) if psutil.pid_exists(pid) else []
    for child in children:
        with suppress(psutil.NoSuchProcess):
            child.kill()
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)
