"""A calibration that moves every latent by as much."""

from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.latent import POOL
from uniforce_vtla.tokenizer.latent_map import LatentMap


def save_calibration(folder, tokenizer, new="tactip:3", shift=0.1):
    """Save one of the sensor ``new`` for a tokenizer's latents; return its folder as text."""
    latent_map = LatentMap(POOL**2, tokenizer.config.latent)
    latent_map.shift.fill_(shift)
    found = Calibration(latent_map, tokenizer.hash, "", new, "tactip:1", 0.0, 0.0, {})
    return str(found.save(folder))
