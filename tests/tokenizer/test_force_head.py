import numpy as np
import pytest
import torch

from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.tokenizer.force_head import (
    ForceHead,
    ForceRegressor,
    HeadConfig,
    HeadTrainingConfig,
    train_head,
)
from uniforce_vtla.tokenizer.latent import Latent


def latents(*shape):
    return Latent.of(torch.randn(*shape), "own")


@pytest.fixture
def head():
    torch.manual_seed(0)
    return ForceHead(ForceRegressor(HeadConfig()), "tactip", "own")


def test_steps_equal_a_sequence_for_every_prefix(head):
    z = latents(2, 5, 64, 6)
    state, read = None, []
    for length, frame in enumerate(z.unbind(1), 1):
        force, state = head.step(frame, state)
        read.append(force)
        sequence = head.sequence(z[:, :length])
        torch.testing.assert_close(torch.stack(read, dim=1), sequence, atol=1e-6, rtol=0)


def test_call_treats_a_batch_as_frames_without_history(head):
    z = latents(4, 64, 6)
    torch.testing.assert_close(head(z), head.sequence(z[:, None])[:, 0], atol=1e-6, rtol=0)
    torch.testing.assert_close(head(z)[2:3], head(z[2:3]), atol=1e-6, rtol=0)
    _, state = head.step(z, None)
    # the second frame remembers the first
    assert not torch.allclose(head.step(z, state)[0], head(z))


def test_trained_head_reads_force_with_and_without_history():
    rng = np.random.default_rng(0)
    force = rng.uniform(-1, 1, (200, 6, 3)).astype(np.float32) * np.array([3, 3, 8], np.float32)
    mixing = rng.standard_normal((3, 6)).astype(np.float32)
    z = torch.from_numpy((force @ mixing)[:, :, None].repeat(16, axis=2))  # (n, T, 16, 6)
    head = train_head(z[:150], force[:150], HeadTrainingConfig(steps=150), seed=0)
    for length in (1, 6):
        with torch.no_grad():
            said = head(z[150:, :length]).numpy()
        error = np.abs(said - force[150:, :length]).mean(axis=(0, 1))
        assert (error < 0.3 * force.std(axis=(0, 1))).all()


def test_training_is_seeded():
    z, force = torch.randn(20, 3, 16, 6), np.random.default_rng(0).random((20, 3, 3), np.float32)
    first, second, third = (
        train_head(z, force, HeadTrainingConfig(steps=3), seed=s) for s in (1, 1, 2)
    )
    assert torch.equal(first.linear.weight, second.linear.weight)
    assert not torch.equal(first.linear.weight, third.linear.weight)


FRAME = torch.zeros(1, 64, 6)


@pytest.mark.parametrize("z", [FRAME[:, 1:], FRAME[..., 1:], FRAME[0], torch.nan * FRAME])
def test_bad_latents_raise(head, z):
    with pytest.raises(ContractError, match="expected"):
        head(Latent.of(z, "own"))
    for frames in (z, torch.stack([torch.zeros_like(z), z], dim=1)):
        with pytest.raises(ContractError):
            head.sequence(Latent.of(frames, "own"))


@pytest.mark.parametrize(
    "z, error",
    [
        (FRAME, ContractError),
        (2 * Latent.of(FRAME, "own"), ContractError),
        (FRAME.numpy(), ContractError),
        (Latent.of(FRAME, "another"), CheckpointError),
    ],
)
def test_latents_of_another_origin_raise(head, z, error):
    for call in (head, head.sequence):
        with pytest.raises(error, match="latents for the force head of tactip"):
            call(z)
