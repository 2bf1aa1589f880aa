import copy
import pickle

import torch

from uniforce_vtla.tokenizer.latent import Latent, pool_latent

Z = Latent.of(torch.arange(96.0).view(1, 16, 6), "own")


def test_what_only_picks_joins_and_moves_keeps_the_origin() -> None:
    kept = [
        *(Z[0], Z[:, None], Z.clone(), Z.cpu(), Z.to(torch.float64), Z.flatten(0, 1), Z.squeeze(0)),
        *(torch.cat([Z, Z]), torch.stack([Z, Z], dim=1), *Z.unbind(0), *iter(Z), pool_latent(Z, 2)),
        *(pickle.loads(pickle.dumps(Z)), copy.deepcopy(Z), Z.expand(3, -1, -1), Z.reshape(4, 24)),
    ]
    assert all(isinstance(z, Latent) and z.tokenizer_hash == "own" for z in kept)


def test_what_computes_gives_plain_tensors() -> None:
    plain = [Z * 2, Z + Z, Z.mean(), Z @ Z[0].T, torch.where(Z > 3, Z, 0.0), Z - 1]
    assert all(type(z) is torch.Tensor for z in plain)
    assert type(Z.numpy()).__name__ == "ndarray" and torch.equal(Z, torch.arange(96.0).view(1, 16, 6))


def test_latents_of_two_origins_join_without_one() -> None:
    for other in (Latent.of(torch.zeros(1, 16, 6), "another"), torch.zeros(1, 16, 6)):
        assert type(torch.cat([Z, other])) is type(torch.stack([other, Z])) is torch.Tensor
