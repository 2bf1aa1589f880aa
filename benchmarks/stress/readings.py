"""Readings of a frozen head on a finger while the expert wipes, by the true wrench or that head."""

from contextlib import suppress
from functools import cache

import numpy as np

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import SensorError
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.latent import Latent


@cache
def shipped_reader() -> tuple[Tokenizer, ForceHead]:
    """Return the shipped tokenizer and the head of the demonstrations' sensor.

    Workers find it by name: a cached function of a program that runs as ``__main__`` can't be sent
    to them.
    """
    return Tokenizer.from_pretrained(), ForceHead.from_pretrained()


def encode_now(env: WipeEnv, finger: Finger, tokenizer: Tokenizer) -> Latent:
    """Return the (1, P, L) pooled latent of a finger; SensorError where its frame is refused."""
    return encode_pair(tokenizer, *env.marker_pair(finger), finger)


def encode_pair(
    tokenizer: Tokenizer, reference: np.ndarray, current: np.ndarray, finger: Finger
) -> Latent:
    """Return the (1, P, L) pooled latent of (480, 640) uint8 images."""
    return tokenizer.pooled(reference, current, finger)


class ReadsWorn(WipeExpert):
    """The expert's law on the head's readings of one worn finger.

    A refused frame repeats the reading before it. A finger's ``calibration`` comes before the head.
    """

    def __init__(
        self,
        finger: Finger,
        tokenizer: Tokenizer,
        head: ForceHead,
        calibration: Calibration | None = None,
    ) -> None:
        super().__init__(fingers=finger)
        self._finger, self._tokenizer, self._head = finger, tokenizer, head
        self._calibration = calibration
        self._read = np.zeros(3)

    def reset(self, env: WipeEnv) -> None:
        self._read = np.zeros(3)
        super().reset(env)

    def _feel(self, env: WipeEnv) -> dict[Finger, np.ndarray]:
        with suppress(SensorError):  # a frame late; the score shows what it costs
            latent = encode_now(env, self._finger, self._tokenizer)
            if self._calibration is not None:
                latent = self._calibration(latent)
            self._read = self._head(latent)[0].numpy()
        return {self._finger: self._read}
