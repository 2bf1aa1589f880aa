"""Stage 3: marker pairs → latent force → newtons."""

from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.latent import Latent, pool_latent
from uniforce_vtla.tokenizer.model import TokenizerConfig

__all__ = ["ForceHead", "Latent", "Tokenizer", "TokenizerConfig", "pool_latent"]
