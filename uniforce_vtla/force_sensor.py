"""``ForceSensor``: raw frame → marker image → latent → calibrated latent → newtons, of one finger.

Every program that feels goes through here: policy, training view, `uniforce show`, `uniforce
touch`, `uniforce calibrate`. Each part is a file of its own:

1. markers: ``markers/canonicalizer.py``, a raw frame becomes a binary marker image.
2. latent: ``tokenizer/api.py``, reference and current image become a latent force map, pooled.
3. calibrated latent: ``tokenizer/latent_map.py``, a map onto the known sensor's latents.
4. newtons: ``tokenizer/force_head.py``, the frozen head reads force.
5. health: ``tokenizer/latent_range.py``, distance from healthy sensors of the same kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
import torch
from torch import nn

from uniforce_vtla.contracts import Finger, check_finger
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.markers.mirror import to_finger_frame
from uniforce_vtla.tokenizer.api import Tokenizer, shipped_sizes
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.force_head import SOURCE, ForceHead
from uniforce_vtla.tokenizer.latent import POOL, pool_latent
from uniforce_vtla.tokenizer.latent_range import HealthMonitor, LatentRange

if TYPE_CHECKING:
    from uniforce_vtla.tokenizer.api import Images

HALF_SECOND = 15  # readings at 30 Hz


@dataclass(frozen=True)
class ForceReading:
    """Reading of one frame of a finger."""

    latent: np.ndarray  # (K, L) float32, calibrated and pooled
    # (3,) on the pad, in the finger's own frame: x right, y down, z into the pad
    force_N: np.ndarray
    # distance from healthy sensors over the largest allowed one, in the last half second; NaN where
    # it isn't watched
    health: float


class ForceSensor:
    """The sense of force of one finger.

    Args:
        kind: registered sensor; "" where only marker images or latents are read.
        finger: finger that wears it.
        calibration: folder of `uniforce calibrate`, or one that is loaded; None for none.
        watch: readings in half a second, over which health is judged; 0 doesn't watch.
        tokenizer: encoder, a size that is shipped, or a folder; None for the shipped one.
        head: force head, or the sensor kind whose shipped head reads newtons; None reads no
            newtons.
        grid: latents are pooled to grid × grid.

    Raises SensorError: an unknown kind; CheckpointError: no such checkpoint, or one that doesn't
    fit.
    """

    def __init__(
        self,
        kind: str,
        finger: Finger = "left",
        *,
        calibration: Calibration | str | Path | None = None,
        watch: int = 0,
        tokenizer: Tokenizer | str | Path | None = None,
        head: ForceHead | str | None = SOURCE,
        grid: int = POOL,
    ) -> None:
        self.kind = kind
        self.finger = check_finger(finger)
        self.grid = grid
        self.canonicalizer = Canonicalizer(kind, stream=True) if kind else None
        folder = None if isinstance(tokenizer, Tokenizer) else tokenizer
        if not isinstance(tokenizer, Tokenizer):
            tokenizer = Tokenizer.from_pretrained(tokenizer)
        self.tokenizer = tokenizer
        beside = shipped_sizes().get(tokenizer.hash, folder)  # where its head and health ranges are
        if isinstance(calibration, str | Path):
            calibration = Calibration.load(calibration, tokenizer.hash)
        if calibration is not None:
            calibration.check_fits(kind, self.finger)
        self.calibration = calibration
        self._map: nn.Module = nn.Identity() if calibration is None else calibration.map
        if isinstance(head, str):
            head = ForceHead.from_pretrained(head, beside)
        self.head = head
        if head is not None:
            _same_tokenizer(head, tokenizer)
        self.monitor = None
        if watch:
            self.monitor = monitor_of(kind, self.finger, beside, watch, calibration)
        self._reference_image: np.ndarray | None = None

    def tare(self, frames: np.ndarray | Sequence[np.ndarray]) -> np.ndarray:
        """Take free air as the reference; return its (480, 640) uint8 marker image.

        Args:
            frames: a raw frame, or several in a row, which must hold still.

        Raises ContractError: frames of the wrong form; SensorError: no markers, a dead sensor, or
        in contact.
        """
        canonicalizer = self._canonicalizer()
        if not isinstance(frames, np.ndarray):
            frames = canonicalizer.free_air(frames)
        canonicalizer.set_reference(frames)
        self.reset()
        self._reference_image = canonicalizer.marker_image(frames)
        return self._reference_image

    def read(self, frame: np.ndarray) -> ForceReading:
        """Return what a raw frame shows.

        Raises ContractError: no ``tare`` before, or a frame of another form; SensorError: no
        markers, a dead sensor, or one that isn't healthy.
        """
        if self._reference_image is None:
            do = "Call tare(frames) in free air first."
            raise ContractError(expected("ForceSensor", "a reference", "none", do))
        image = self._canonicalizer().marker_image(frame)
        return self.read_markers(self._reference_image, image)

    @torch.no_grad()
    def read_markers(self, reference: np.ndarray, current: np.ndarray) -> ForceReading:
        """Return what a pair of (H, W) marker images shows, free air and now.

        Raises as ``encode``.
        """
        latent = self.encode(reference[None], current[None])
        force_N = np.full(3, np.nan, np.float32)
        if self.head is not None:
            canonical_N = self.newtons(latent)[0].cpu().numpy()
            force_N = to_finger_frame(canonical_N, self.finger)
        health = float("nan") if self.monitor is None else self.monitor.health
        return ForceReading(latent[0].cpu().numpy(), force_N, health)

    @torch.no_grad()
    def read_forces(self, reference: np.ndarray, current: np.ndarray) -> np.ndarray:
        """Return (B, 3) float32 N of (B, H, W) marker images against a (H, W) reference.

        In the finger's own frame; raises as ``encode``.
        """
        latent = self.encode(reference[None], current)
        return to_finger_frame(self.newtons(latent).cpu().numpy(), self.finger)

    @torch.no_grad()
    def newtons(self, latent: torch.Tensor) -> torch.Tensor:
        """Return (B, 3) N, canonical frame, of calibrated pooled latents (B, K, L).

        Raises ContractError: it has no head.
        """
        if self.head is None:
            do = "Name a head."
            raise ContractError(expected("ForceSensor", "a force head", "none", do))
        return self.head.model.step(latent, None)[0]

    def facts(self) -> dict[str, str]:
        """Return the hashes of everything that decides its newtons; datasets store them."""
        facts = {"tokenizer": self.tokenizer.hash}
        if self.head is not None:
            facts["force_head"] = self.head.hash
        if self.calibration is not None:
            facts["calibration"] = self.calibration.hash
        return facts

    @torch.no_grad()
    def encode(self, reference: Images, current: Images) -> torch.Tensor:
        """Return calibrated pooled latents (B, K, L) of marker images (B, H, W).

        Raises ContractError: images of the wrong form; SensorError: a sensor that isn't healthy,
        which is a FreeAirError in the first readings.
        """
        latent = self.raw_latent(reference, current)
        if self.monitor is not None:
            self.monitor.see(latent)
        return self._map(latent)

    @torch.no_grad()
    def renew(self, free: Images) -> torch.Tensor:
        """Start to read against another reference in free air; return its latents, not judged."""
        if self.monitor is not None:
            self.monitor.reset(renewed=True)
        return self._map(self.raw_latent(free, free))

    def raw_latent(self, reference: Images, current: Images) -> torch.Tensor:
        """Return pooled latents (B, K, L), neither judged nor calibrated."""
        latent = self.tokenizer.latents(reference, current, self.finger)  # (B, P, L)
        return pool_latent(latent, self.grid)

    def reset(self) -> None:
        """Start an episode in free air."""
        self.tokenizer.forget_references()
        if self.monitor is not None:
            self.monitor.reset()

    def to(self, device: torch.device | str) -> Self:
        """Move everything that holds tensors."""
        self.tokenizer.model.to(device)
        if self.head is not None:
            self.head.model.to(device)
        self._map.to(device)
        if self.monitor is not None:
            self.monitor.to(torch.device(device))
        self.reset()
        return self

    def _canonicalizer(self) -> Canonicalizer:
        if self.canonicalizer is None:
            do = "Name the kind of sensor."
            raise ContractError(expected("ForceSensor", "a sensor's raw frames", "no kind", do))
        return self.canonicalizer


def _same_tokenizer(head: ForceHead, tokenizer: Tokenizer) -> None:
    if head.tokenizer_hash != tokenizer.hash:
        do = "Load both of one size or folder."
        came = head.tokenizer_hash
        raise CheckpointError(expected("tokenizer of the force head", tokenizer.hash, came, do))


def monitor_of(
    kind: str,
    finger: Finger,
    size: str | Path | None,
    readings: int,
    calibration: Calibration | None,
    free_air: bool = True,
) -> HealthMonitor:
    """Return the monitor of a shipped kind, for the tokenizer of a size.

    A sensor that is calibrated to one of its own kind has to look like that one: it is judged after
    the map.

    Raises CheckpointError: no range of latents is shipped for that kind and tokenizer.
    """
    is_within_kind = calibration is not None and calibration.anchor.partition(":")[0] == kind
    latent_map = calibration.map if calibration is not None and is_within_kind else None
    healthy_range = LatentRange.from_pretrained(kind, size)
    return HealthMonitor(healthy_range, finger, readings, latent_map, free_air)
