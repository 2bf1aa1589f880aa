"""One look at a finger: the newest sample through canonicaliser, tokenizer and force head."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uniforce_robots.sensors.finger import TactileFinger
from uniforce_vtla.contracts import Finger
from uniforce_vtla.markers.mirror import to_canonical, to_finger_frame
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.streaming import StreamingEncoder

WAIT_MS = 1000.0


@dataclass(frozen=True)
class TouchView:
    """What is shown.

    Attributes:
        label: which sensor on which finger.
        raw: (H, W, 3) uint8 RGB, or (16, 3) int64 counts above the reference.
        markers: (480, 640) uint8 marker image, as the sensor sees it.
        norms: (g, g) float32, length of each patch's latent minus its free-air latent; as the sensor sees it.
        force_N: (3,) in the finger's own frame, image axes; None without a head.
        age_ms: how old the sample was when it was looked at.
        rate_hz: measured.
        lost: samples lost so far.
    """

    label: str
    raw: np.ndarray
    markers: np.ndarray
    norms: np.ndarray
    force_N: np.ndarray | None
    age_ms: float
    rate_hz: float
    lost: int


class LiveTouch:
    """Looks at a connected finger that has its reference.

    Args:
        finger: the device.
        side: who wears it.
        tokenizer: makes latents.
        head: reads newtons; None shows none.
        label: what to call it.

    Raises:
        CheckpointError: a head of another tokenizer.
        ContractError: a finger without reference.
    """

    def __init__(
        self, finger: TactileFinger, side: Finger, tokenizer: Tokenizer, head: ForceHead | None, label: str
    ) -> None:
        self._finger, self._side, self._label = finger, side, label
        self._encoder = StreamingEncoder(tokenizer, side, head)
        reference = finger.reference_image()[..., 0]
        self._encoder.set_reference(reference)
        self._free = self._encoder.step(reference).latent
        self._encoder.set_reference(reference)  # the head forgets that look
        self._grid = math.isqrt(tokenizer.num_patches)
        self._index = -1

    def look(self) -> TouchView:
        """Return the next new sample's view; raises SensorError where there is none."""
        touch = self._finger.next_touch(self._index, WAIT_MS)
        self._index = touch.index
        markers = self._finger.marker_image(touch.raw)
        step = self._encoder.step(markers)
        norms = (step.latent - self._free).norm(dim=-1).numpy().reshape(self._grid, self._grid)
        force_N = None if step.force_N is None else to_finger_frame(step.force_N, self._side)
        raw = touch.raw
        if raw.ndim == 2:  # counts mean little without their rest
            raw = raw.astype(np.int64) - self._finger.reference_raw
        return TouchView(
            label=self._label,
            raw=raw,
            markers=markers,
            norms=to_canonical(norms, self._side),  # undoes the encoder's mirror: its own inverse
            force_N=force_N,
            age_ms=touch.age_ms,
            rate_hz=self._finger.rate_hz,
            lost=self._finger.counts.lost,
        )
