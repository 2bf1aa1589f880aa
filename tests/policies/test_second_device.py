"""Every path of touch and sampler on a second device gives what it gives on the CPU.

The device is far_device.py's on any machine, and a GPU where there is one.
"""

import contextlib

import pytest
import torch
from far_device import NAME, far_device
from policy_samples import OPEN, alive, calibrate, watched, with_dots

from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import MEASURED_STATE
from lerobot_policy_pi05_uniforce.sampler import fast, prefix
from lerobot_policy_pi05_uniforce.sampler.cuda_graphs import GraphedSampler
from lerobot_policy_pi05_uniforce.touch.touch_input import marker_images
from uniforce_vtla.errors import SensorError
from uniforce_vtla.keys import tactile_key
from uniforce_vtla.tokenizer.latent_range import FREE_LOOKS

GPU = pytest.param(
    "cuda",
    marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device: not run"),
)
DEVICES = pytest.mark.parametrize("device", [NAME, GPU])
TOLERANCE = {NAME: 1e-5, "cuda": 1e-3}  # m, m, m, rad, m: another order of summation on a GPU
LOOKS = FREE_LOOKS + 1
WATCHED = {"touch__input": "latent", "touch__tokenizer_path": None}
PATHS = {
    "none": {"touch__input": "none"},
    "wrench": {"touch__input": "wrench"},
    "monitor": WATCHED,
    "gate": WATCHED | {"touch__start_at_base": True},
    "newtons": {"touch__input": "newtons"},
    "shear": {"touch__input": "shear"},
    "gripped shear": {"touch__input": "gripped_shear"},
    "axis trust": {"touch__input": "flagged_newtons"},
    "swap": WATCHED | {"touch__slots": {"touch0": "right"}, "swap": "touch0:left"},
    "calibrated": {"touch__input": "newtons"},
    "held grip": {"touch__input": "newtons", "touch__carried_N": {"touch0": 8.9, "touch1": 8.9}},
    "masked": WATCHED,
    "lost": WATCHED | {"touch__on_sensor_loss": "mask"},
    "flow": WATCHED | {"action__objective": "flow", "num_inference_steps": 3},
    "stock": WATCHED | {"sampler__kind": "stock"},
}


@pytest.fixture
def make(make_policy, make_config, tmp_path):
    """Return a function from a path's name to its policy."""

    def made(path):
        settings = dict(PATHS[path])
        if path == "calibrated":
            config = make_policy(**settings).config
            settings["right_calibration"] = calibrate(tmp_path, config, shift=0.1, gain=1.2)
        if path == "held grip":
            settings["grip"] = "held"
        policy = alive(make_policy(**settings, sampler__noise_scale=0.0))
        if path == "gate":
            alive(policy, OPEN)
        if policy.config.encodes:
            watched(policy, 99.0)
        policy.touch.masked = path == "masked"
        return policy

    return made


@contextlib.contextmanager
def moved(policy, device):
    """Move a policy; on the fake device the functions that a GPU replays run on buffers of their own."""
    with far_device() if device == NAME else contextlib.nullcontext() as crossings:
        if device == NAME and policy.model.fast is not None:
            policy.model.fast.graphed = GraphedSampler(policy.model.fast, capture=False)
            if policy.model.tactile_encoder is not None:
                policy.model.tactile_encoder.replayed.device = NAME
                policy.model.tactile_encoder.replayed.recordings.capture = False
        yield policy.to(device), crossings


def episodes(policy, batch, device):
    """Return the actions (2, LOOKS, B, 5) of two episodes, the hand lifted and touch changed on the way."""
    actions = []
    for _ in range(2):
        policy.reset()
        for look in range(LOOKS):
            seen = dict(batch)
            for finger in ("left", "right"):
                if tactile_key(finger) in batch:
                    seen[tactile_key(finger)] = batch[tactile_key(finger)].roll(look, dims=-1)
            seen[MEASURED_STATE] = batch[MEASURED_STATE] + 0.001 * look
            seen = {k: v.to(device) if isinstance(v, torch.Tensor) else v for k, v in seen.items()}
            policy._action_queue.clear()
            actions.append(policy.select_action(seen).cpu())
    return torch.stack(actions)


@DEVICES
@pytest.mark.parametrize("path", PATHS)
def test_it_acts_as_on_the_cpu(path, device, make, make_batch):
    policy = make(path)
    batch = with_dots(make_batch(policy, size=1))
    if path == "lost":
        batch.pop(tactile_key("left"))
    wanted = episodes(policy, batch, "cpu")
    with moved(policy, device):
        came = episodes(policy, batch, device)
    assert (came - wanted).abs().max() < TOLERANCE[device]
    assert (wanted[0] - wanted[1]).abs().max() > 0


@DEVICES
def test_a_sensor_that_is_not_healthy_stops_it(device, make, make_batch):
    policy = watched(make("monitor"))
    batch = make_batch(policy, size=1)
    with moved(policy, device), pytest.raises(SensorError, match="tactip on the right finger"):
        episodes(policy, batch, device)


@DEVICES
def test_an_open_hand_takes_a_new_reference(device, make, make_batch, caplog):
    policy = make("monitor")
    batch = make_batch(policy, size=1)
    sensor = watched(policy).touch.sensors["touch0"]
    current = marker_images(batch, "right")[1]
    sensor.monitor._usual.mean = sensor.raw_latent(current, current)[0].flatten()
    open_m = batch[MEASURED_STATE][0, 4].item()
    policy.config.action.target_range = [[0.0] * 5, [0.0] * 4 + [open_m]]
    with moved(policy, device):
        batch = {k: v.to(device) if isinstance(v, torch.Tensor) else v for k, v in batch.items()}
        latents = [policy.felt(batch).touches[0].cpu() for _ in range(FREE_LOOKS)]
    assert torch.equal(latents[0], latents[1]) and not torch.equal(latents[1], latents[2])
    assert sum("new reference" in record.message for record in caplog.records) == 1


def test_the_host_reads_masks_and_verdicts_and_nothing_else(make, make_batch):
    policy = make("monitor")
    batch = with_dots(make_batch(policy, size=1))
    with moved(policy, NAME) as (_, crossings):
        far = {k: v.to(NAME) if isinstance(v, torch.Tensor) else v for k, v in batch.items()}
        policy.predict_action_chunk(far)
        crossings.crossed.clear()
        policy.predict_action_chunk(far)
    recorded = policy.model.tactile_encoder.replayed.recordings.kept
    assert len(recorded) == len(policy.model.fast.graphed.recordings.kept) == 1
    assert max(crossings.crossed) <= policy.config.tokenizer_max_length
    assert sum(count == 1 for count in crossings.crossed) < 20


def to_the_host(real):
    return lambda *args, **kwargs: real(*args, **kwargs).cpu()


def without_a_device(real_mask, gated):
    return torch.zeros(real_mask.shape)[:, None, None]


@pytest.mark.parametrize(
    ("module", "name", "fault"),
    [
        (fast, "attend_folded", to_the_host(fast.attend_folded)),
        (prefix, "_additive", without_a_device),
    ],
)
def test_a_tensor_of_the_host_is_found(module, name, fault, make, make_batch, monkeypatch):
    policy = make("gate")
    batch = with_dots(make_batch(policy, size=1))
    monkeypatch.setattr(module, name, fault)
    with moved(policy, NAME), pytest.raises(RuntimeError, match="all tensors on one device"):
        episodes(policy, batch, NAME)
