import numpy as np
import pytest
import torch
from policy_samples import small_config, watched

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy
from lerobot_policy_pi05_uniforce import make_pi05_uniforce_pre_post_processors as make_processors
from lerobot_policy_pi05_uniforce.controller import PolicyController, shipped_checkpoint
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import MEASURED_STATE
from lerobot_policy_pi05_uniforce.touch.touch_input import marker_images
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig

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
        touch = {"touch__slots": {"touch0": "right", "touch1": "left"}, "touch__input": "latent"}
        # only the shipped tokenizers have a head
        if settings.get("touch__input") != "newtons":
            touch["touch__tokenizer_path"] = str(tokenizer_path)
        cameras = ("front", "wrist", "tactile_left", "tactile_right")
        return small_config(cameras, **in_groups(touch | settings))

    return make


def in_groups(settings):
    """``touch__input="wrench"`` → ``touch=TouchSettings(input="wrench")``."""
    made = {}
    groups = {}
    for name, value in settings.items():
        group, _, setting = name.partition("__")
        if setting:
            groups.setdefault(group, {})[setting] = value
        else:
            made[name] = value
    for group, values in groups.items():
        made[group] = PI05UniforceConfig.__dataclass_fields__[group].default_factory(**values)
    return made


@pytest.fixture
def make_policy(make_config):
    return lambda **settings: PI05UniforcePolicy(make_config(**settings)).eval()


@pytest.fixture
def policy(make_policy):
    return make_policy()


@pytest.fixture
def make_batch(stats):
    """A preprocessed batch for a policy: cameras, state, marker images, wrenches, text and
    actions."""

    def make(policy, size=2):
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
        steps = len(policy.config.action_delta_indices)
        batch["action"] = _between(torch.rand(size, steps, 5))
        batch["action_is_pad"] = torch.zeros(size, steps, dtype=torch.bool)
        return before(batch)

    return make


def _between(share):
    return (torch.from_numpy(LOW) + torch.from_numpy(HIGH - LOW) * share).float()


@pytest.fixture
def batch(make_batch, policy):
    return make_batch(policy)


@pytest.fixture
def in_free_air():
    """Return a function: the hand is as open as in demos, and its right sensor asks for a new
    reference."""

    def make(policy, batch):
        sensor = watched(policy).touch.sensors["touch0"]
        current = marker_images(batch, "right")[1]
        sensor.monitor._healthy_range.mean = sensor.raw_latent(current, current)[0].flatten()
        open_m = batch[MEASURED_STATE][0, 4].item()
        policy.config.action.target_range = [[0.0] * 5, [0.0] * 4 + [open_m]]
        return policy

    return make


@pytest.fixture
def make_controller():
    """Return a function: the shipped policy on the sensors that it was trained with."""
    mounted = {"left": "gelsight", "right": "tactip"}
    return lambda **more: PolicyController(shipped_checkpoint(), mounted, **more)
