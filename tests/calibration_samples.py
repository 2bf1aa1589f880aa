"""A calibration that moves every latent by as much."""

from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.latent import POOL
from uniforce_vtla.tokenizer.latent_map import LatentMap


def save_calibration(folder, tokenizer, new="tactip:3", shift=0.1):
    """Save one of the sensor ``new`` for a tokenizer's latents; return its folder as text."""
    found = LatentMap(POOL**2, tokenizer.config.latent)
    return save_shift(folder, found, shift, tokenizer.hash, "", new, "tactip:1")


def save_shift(folder, latent_map, shift, *names, judged=None):
    """Save a calibration whose map adds ``shift``; names: hashes of tokenizer and head, new,
    anchor."""
    latent_map.shift.fill_(shift)
    return str(Calibration(latent_map, *names, 1.0, 0.0, judged or {}).save(folder))
