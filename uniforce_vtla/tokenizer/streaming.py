"""One finger's encoder at the sensor's own rate: marker image in, latent and newtons out, in bounded memory.

The tokenizer remembers the reference's keys and values; what is kept from frame to frame is the force head's state.
"""

from typing import NamedTuple

import numpy as np
import torch

from uniforce_vtla.contracts import Finger, check_finger
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.latent import Latent


class StreamStep(NamedTuple):
    """One frame's answer: ``latent`` (P, L) float32; ``force_N`` (3,) in the canonical frame, None without a head.

    ``markers.mirror.to_finger_frame`` takes the force to the finger's own frame.
    """

    latent: Latent
    force_N: np.ndarray | None


class StreamingEncoder:
    """Encodes one finger frame by frame; a new reference starts a new episode.

    Args:
        tokenizer: the frozen encoder; several streams may share it.
        finger: who wears the sensor; the right finger's images are mirrored.
        head: reads newtons from latents, remembering the frames before; None for latents only.

    Raises ContractError: unknown finger; CheckpointError: a head that was trained on another tokenizer's latents.
    """

    def __init__(self, tokenizer: Tokenizer, finger: Finger, head: ForceHead | None = None) -> None:
        self.finger = check_finger(finger)
        if head is not None and head.tokenizer_hash != tokenizer.hash:
            do = "Load a pair that fits."
            raise CheckpointError(expected("tokenizer of the head", tokenizer.hash, head.tokenizer_hash, do))
        self._tokenizer = tokenizer
        self._head = head
        self._reference: np.ndarray | None = None
        self._state: torch.Tensor | None = None  # of the head, after the frames before

    def set_reference(self, image: np.ndarray) -> None:
        """Take ``image`` (H, W) as free air and forget every frame before it.

        A reference that is refused leaves none: going on with an old one would pass unnoticed.

        Raises ContractError: not one image, NaN, or without markers.
        """
        self._reference, self._state = None, None
        self._tokenizer.encode_reference(_one(image, "reference"), self.finger)  # refuses what is none
        self._reference = image.copy()

    def step(self, image: np.ndarray) -> StreamStep:
        """Return the answer to the next frame (H, W), of the reference's size.

        A frame that is refused changes nothing.

        Raises ContractError: no reference yet, another size, NaN, or a form the tokenizer doesn't take.
        """
        if self._reference is None:
            raise ContractError(expected("stream", "a reference first", "a frame", "Call set_reference in free air."))
        z = self._tokenizer.encode(self._reference, _one(image, "current"), self.finger)  # (1, P, L)
        if self._head is None:
            return StreamStep(z[0], None)
        force, self._state = self._head.step(z, self._state)
        return StreamStep(z[0], force[0].numpy())


def _one(image: np.ndarray, name: str) -> np.ndarray:
    """Return (1, H, W) of an (H, W) image."""
    if not isinstance(image, np.ndarray) or image.ndim != 2:
        came = getattr(image, "shape", type(image).__name__)
        raise ContractError(expected(name, "one (H, W) image", came, "Pass frames one by one."))
    return image[None]
