"""UniForce (FT): our tokenizer's encoder and a head, fine-tuned together on the source's labels."""

import copy

import torch
from torch import nn

from benchmarks.baselines.cells import Predictor, fitted_row, labels, pictures
from benchmarks.baselines.end_to_end import EndToEnd, EndToEndConfig, predictor, train_end_to_end
from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import POOL, Cells, Table, encode_set, sized_head
from uniforce_vtla.tokenizer import Tokenizer, pool_latent
from uniforce_vtla.tokenizer.force_head import HeadTrainingConfig, train_head
from uniforce_vtla.tokenizer.model import Encoder

# The second stage, after the usual head on frozen latents. A tenth of pretraining's rate for the encoder: it is to
# bend, not to forget.
TOGETHER = EndToEndConfig(steps=300, learning_rate=3e-4, encoder_rate=1 / 3)


class TokenizerEncoder(nn.Module):
    """A trainable copy of a tokenizer's encoder; gives what ``encode_set`` gives."""

    def __init__(self, tokenizer: Tokenizer) -> None:
        super().__init__()
        self.encoder: Encoder = copy.deepcopy(tokenizer.model.encoder).requires_grad_(True)

    def forward(self, reference: torch.Tensor, frames: torch.Tensor) -> torch.Tensor:
        """Return (B, F, POOL², L)."""
        count = frames.shape[1]
        cache = self.encoder.encode_reference(reference).repeat(count)
        z = self.encoder.encode_current(cache, frames.flatten(0, 1)[:, None]).mean  # (B·F, P, L)
        return pool_latent(z, POOL).unflatten(0, frames.shape[:2])


def finetuned_row(
    table: Table, tokenizer: Tokenizer, seeds: int, config: EndToEndConfig = TOGETHER
) -> Cells:
    """Return the row of encoders fine-tuned on each source sensor; ``tokenizer`` itself stays as it is."""
    return fitted_row(
        table,
        lambda source, seed: fit_finetuned(source, tokenizer, table.head, config, seed),
        seeds,
    )


def fit_finetuned(
    source: LabelledSet,
    tokenizer: Tokenizer,
    head: HeadTrainingConfig,
    config: EndToEndConfig,
    seed: int,
) -> Predictor:
    """Return a predictor: head on frozen latents first, then both together."""
    z = encode_set(tokenizer, source)
    model = EndToEnd(
        TokenizerEncoder(tokenizer), train_head(z, source.force_N, sized_head(head, z, POOL), seed)
    )
    train_end_to_end(model, pictures(source), labels(source), config, seed)
    return predictor(model, config.device)
