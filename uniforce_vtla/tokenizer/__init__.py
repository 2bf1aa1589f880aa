"""Stage 3: marker pairs → latent force → newtons."""

from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.latent import Latent
from uniforce_vtla.tokenizer.model import TokenizerConfig
from uniforce_vtla.tokenizer.pooling import pool_latent

__all__ = ["ForceHead", "Latent", "Tokenizer", "TokenizerConfig", "pool_latent"]
