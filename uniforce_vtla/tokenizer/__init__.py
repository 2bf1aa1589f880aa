"""Stage 3: marker pairs → latent force."""

from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.model import TokenizerConfig
from uniforce_vtla.tokenizer.pooling import pool_latent

__all__ = ["Tokenizer", "TokenizerConfig", "pool_latent"]
