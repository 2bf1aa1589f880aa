"""Stage 3: marker pairs → latent force → newtons.

Names are looked up when they are first used: settings need no torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uniforce_vtla.tokenizer.api import Tokenizer
    from uniforce_vtla.tokenizer.force_head import ForceHead
    from uniforce_vtla.tokenizer.latent import Latent, pool_latent
    from uniforce_vtla.tokenizer.settings import TokenizerConfig

__all__ = ["ForceHead", "Latent", "Tokenizer", "TokenizerConfig", "pool_latent"]

_HOME = {"ForceHead": "force_head", "Tokenizer": "api", "TokenizerConfig": "settings"}


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME.get(name, 'latent')}"), name)
