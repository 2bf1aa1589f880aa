"""Is a fault the tokenizer's or any reader's?  Press read from other features of the same frames.

Each is read by a ridge that was fitted on the sensor itself, without the fault and with its force known: more than the
tokenizer's own head is given, which knew neither the unit nor the scene.
"""

from collections.abc import Mapping

import numpy as np
from sklearn.pipeline import Pipeline

from benchmarks.real.readouts import fit_readout
from benchmarks.stress.readings import Features, encode_pair, read_scenes
from uniforce_vtla.contracts import Finger
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS
from uniforce_vtla.tokenizer.plain_touch import descriptors

RIDGE = 10.0  # on standardised features
Readers = Mapping[str, Pipeline]  # name → (n, F) features → (n,) N of press


def features_of(tokenizer: Tokenizer) -> dict[str, Features]:
    """Return name → features beside the tokenizer's: latents of an untrained one of its size, hand descriptors."""
    untrained = Tokenizer.random(tokenizer.config, seed=0)
    return {
        "untrained encoder": lambda *pair: encode_pair(untrained, *pair).numpy().ravel(),
        "hand descriptors": _described,
    }


def _described(reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
    return descriptors(reference, current[None], finger)[0] / np.asarray(NATURAL_UNITS)


def fit_readers(
    level: str, sensor: str, seeds: range, tokenizer: Tokenizer, pressed_N: float
) -> Readers:
    """Return a reader of the press per kind of feature, fitted to moments with more press than ``pressed_N``."""
    found = read_scenes(level, "right", sensor, seeds, tokenizer, features_of(tokenizer))
    pressed = found.press_N > pressed_N
    return {
        name: fit_readout(of[pressed], found.press_N[pressed], RIDGE)
        for name, of in found.features.items()
    }
