"""Every path of touch and sampler on a second device gives what it gives on the CPU.

The device is far_device.py's on any machine, and a GPU where there is one.
"""

import contextlib

import pytest
import torch
from far_device import NAME, far_device
from policy_samples import OPEN, alive, calibrate, watched, with_dots

from lerobot_policy_pi05_uniforce.cuda_graphs import Recordings
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import MEASURED_STATE
from lerobot_policy_pi05_uniforce.sampler import fast, layers, prefix
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.keys import tactile_key
from uniforce_vtla.tokenizer.latent_map import LatentMap
from uniforce_vtla.tokenizer.latent_range import FREE_LOOKS

GPU = pytest.param(
    "cuda",
    marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device: not run"),
)
DEVICES = pytest.mark.parametrize("device", [NAME, GPU])
TOLERANCE = {NAME: 1e-5, "cuda": 1e-3}  # m, m, m, rad, m: another order of summation on a GPU
LOOKS = FREE_LOOKS + 1
WATCHED = {"touch__input": "latent", "touch__tokenizer_path": None}
INPUTS = ("none", "wrench", "newtons")
NEWTONS = {"touch__input": "newtons"}
PATHS = {name: {"touch__input": name} for name in INPUTS} | {
    "monitor": WATCHED,
    "gate": WATCHED | {"touch__start_at_base": True},
    "swap": WATCHED | {"touch__slots": {"touch0": "right"}, "swap": "touch0:left"},
    "calibrated": NEWTONS,
    "new reference": WATCHED,
    "masked": WATCHED,
    "lost": WATCHED | {"touch__on_sensor_loss": "mask"},
    "flow": WATCHED | {"action__objective": "flow", "num_inference_steps": 3},
    "stock": WATCHED | {"sampler__kind": "stock"},
}


@pytest.fixture
def make(make_policy, tmp_path):
    """Return a function from a path's name to its policy."""

    def made(path):
        settings = dict(PATHS[path])
        if path == "calibrated":
            config = make_policy(**settings).config
            settings["right_calibration"] = calibrate(tmp_path, config, shift=0.1)
        policy = make_policy(**settings)
        alive(policy, OPEN if path == "gate" else None)
        if policy.config.encodes:
            # a map that nothing but the monitor holds
            monitor = watched(policy, 99.0).touch.sensors["touch0"].monitor
            monitor._calibration_map = LatentMap(16, 6)
        if path == "masked":
            policy.touch.hidden.update(FINGERS)
        return policy

    return made


@contextlib.contextmanager
def moved(policy, device):
    """Move a policy; on the fake device the functions that a GPU replays run on buffers of their
    own."""
    with far_device() if device == NAME else contextlib.nullcontext() as crossings:
        if device == NAME and policy.model.fast is not None:
            policy.model.fast.recordings = Recordings(capture=False)
            if policy.model.tactile_encoder is not None:
                policy.model.tactile_encoder.replayed.device = NAME
                policy.model.tactile_encoder.replayed.recordings.capture = False
        yield policy.to(device), crossings


def on(batch, device):
    return {k: v.to(device) if isinstance(v, torch.Tensor) else v for k, v in batch.items()}


def episodes(policy, batch, device):
    """Return the actions of two episodes, the hand lifted and touch changed on the way.

    The first one begins as the policy came: whoever moves it to a device starts an episode.
    """
    actions = []
    for look in range(2 * LOOKS):
        if look == LOOKS:
            policy.reset()
        seen = dict(batch)
        for finger in ("left", "right"):
            if tactile_key(finger) in batch:
                seen[tactile_key(finger)] = batch[tactile_key(finger)].roll(look % LOOKS, dims=-1)
        seen[MEASURED_STATE] = batch[MEASURED_STATE] + 0.001 * (look % LOOKS)
        policy._action_queue.clear()
        actions.append(policy.select_action(on(seen, device)).cpu())
    return torch.stack(actions)


@DEVICES
@pytest.mark.parametrize("path", PATHS)
def test_it_acts_as_on_the_cpu(path, device, make, make_batch, in_free_air):
    policy = make(path)
    batch = with_dots(make_batch(policy, size=1))
    if path == "lost":
        batch.pop(tactile_key("left"))
    if path == "new reference":
        in_free_air(policy, batch)
    wanted = episodes(policy, batch, "cpu")
    with moved(policy, device):
        came = episodes(policy, batch, device)
    assert (came - wanted).abs().max() < TOLERANCE[device]
    assert (wanted[0] - wanted[1]).abs().max() > 0


def test_the_host_reads_masks_and_verdicts_and_nothing_else(make, make_batch):
    policy = make("monitor")
    batch = with_dots(make_batch(policy, size=1))
    with moved(policy, NAME) as (_, crossings):
        for _ in range(2):
            crossings.crossed.clear()
            policy.predict_action_chunk(on(batch, NAME))
    recorded = policy.model.tactile_encoder.replayed.recordings.kept
    assert len(recorded) == len(policy.model.fast.recordings.kept) == 1
    assert max(crossings.crossed) <= policy.config.tokenizer_max_length
    assert sum(count == 1 for count in crossings.crossed) < 20


def to_the_host(*given):
    return layers.attend_folded(*given).cpu()


def without_a_device(real_mask, gated):
    return torch.zeros(real_mask.shape)[:, None, None]


@pytest.mark.parametrize(
    "place", [(fast, "attend_folded", to_the_host), (prefix, "_additive", without_a_device)]
)
def test_a_tensor_of_the_host_is_found(place, make, make_batch, monkeypatch):
    policy = make("gate")
    batch = with_dots(make_batch(policy, size=1))
    monkeypatch.setattr(*place)
    with moved(policy, NAME), pytest.raises(RuntimeError, match="all tensors on one device"):
        episodes(policy, batch, NAME)
