"""Sensor health check: Mahalanobis distance of latents from healthy sensors of the same kind.

A camera that moved, a reference taken under load or markers that come and go still give a latent,
and a head still reads newtons in it. The distance notices them: healthy units lie close together
whatever they touch. It can't notice a sensor that answers too little, because that looks like a
lighter touch.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path

import torch
from torch import nn

from uniforce_vtla.errors import CheckpointError, ContractError, SensorError, expected
from uniforce_vtla.tokenizer.weights import (
    checkpoint_folder,
    load_model,
    read_config,
    save_checkpoint,
)

# of the mean variance, added to each: directions in which no unit moved must not decide alone
FLOOR = 0.01
FREE_LOOKS = 3  # at the start of an episode, before anything is touched
# Factors that relax the limits after re-referencing, in free air and in contact. Markers that come
# and go are left then: with a fifth of them missing (2.0 to 2.5 × the limit) a policy that wasn't
# stopped wiped six boards of six, none too hard.
RENEWED_FREE = 2.6
RENEWED_RUN = 1.4


class FreeAirError(SensorError):
    """Nothing is touched yet, and the picture is unlike its reference.

    A new reference may be all it needs.
    """


class LatentRange(nn.Module):
    """Mean and covariance of a kind's pooled latents, and how far healthy units go.

    Args:
        kind: of sensor.
        tokenizer_hash: whose latents.
        size: numbers of a latent, P · L.
        free_limit: largest mean distance of a healthy unit's first looks, in free air.
        run_limit: largest mean distance of a healthy unit over half a second.
    """

    mean: torch.Tensor
    whitening: torch.Tensor

    def __init__(
        self, kind: str, tokenizer_hash: str, size: int, free_limit: float, run_limit: float
    ) -> None:
        super().__init__()
        self.kind = kind
        self.tokenizer_hash = tokenizer_hash
        self.free_limit = free_limit
        self.run_limit = run_limit
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("whitening", torch.eye(size))

    @classmethod
    def fit(cls, latents: torch.Tensor, kind: str, tokenizer_hash: str) -> LatentRange:
        """Return the range of (n, P, L) pooled latents; its limits are infinite until they are set.

        Raises ContractError: fewer latents than numbers in one.
        """
        rows = latents.flatten(1)
        count, size = rows.shape
        if count <= size:
            raise ContractError(
                expected("latents", f"more than {size}", count, "Draw more contacts.")
            )
        found = cls(kind, tokenizer_hash, size, float("inf"), float("inf"))
        variance, axes = torch.linalg.eigh(torch.cov(rows.T.double()))
        found.mean = rows.mean(dim=0)
        found.whitening = (axes / (variance + FLOOR * variance.mean()).sqrt()).float()
        return found

    @classmethod
    def from_pretrained(cls, kind: str, path: str | Path | None = None) -> LatentRange:
        """Load the shipped range of a kind for a size of tokenizer, or the range in a folder.

        Raises CheckpointError: no range for that kind, or a checkpoint that doesn't fit.
        """
        folder = checkpoint_folder(path, f"latent_range_{kind}")
        facts = read_config(folder)
        try:
            found = str(facts["kind"]), str(facts["tokenizer_hash"]), int(facts["size"])
            limits = float(facts["free_limit"]), float(facts["run_limit"])
        except (KeyError, TypeError, ValueError) as error:
            wanted = "kind, tokenizer_hash, size, free_limit, run_limit"
            raise CheckpointError(
                expected(f"config of {folder}", wanted, error, "Is this a latent range?")
            ) from error
        return load_model(folder, lambda: cls(*found, *limits))

    def save(self, path: str | Path) -> Path:
        """Write buffers and facts to a folder that ``from_pretrained`` reads."""
        facts = {"kind": self.kind, "tokenizer_hash": self.tokenizer_hash, "size": len(self.mean)}
        return save_checkpoint(
            Path(path), self, facts | {"free_limit": self.free_limit, "run_limit": self.run_limit}
        )

    def distance(self, latents: torch.Tensor) -> torch.Tensor:
        """Return (B,) Mahalanobis distances of (B, P, L) pooled latents, rms over their numbers."""
        whitened = (latents.flatten(1) - self.mean) @ self.whitening
        return whitened.square().mean(dim=1).sqrt()


class HealthMonitor:
    """Watches one finger through an episode.

    Args:
        healthy_range: of the kind of sensor on it.
        finger: name in messages.
        readings: that make half a second.
        calibration_map: onto a unit of that kind; latents are judged behind it.
        free_air: whether the first ``FREE_LOOKS`` readings come before anything is touched.
    """

    def __init__(
        self,
        healthy_range: LatentRange,
        finger: str,
        readings: int,
        calibration_map: nn.Module | None = None,
        free_air: bool = True,
    ) -> None:
        self._healthy_range = healthy_range
        self._finger = finger
        self._calibration_map = calibration_map
        self._free_air = free_air
        self._recent: deque[float] = deque(maxlen=readings)
        self.active = True  # False while a policy trains: samples are in no order
        self.reset()

    def to(self, device: torch.device) -> None:
        """Follow the policy to its device."""
        for own in filter(None, (self._healthy_range, self._calibration_map)):
            own.to(device)

    def reset(self, renewed: bool = False) -> None:
        """Start an episode, in free air.

        ``renewed``: once more, with a reference taken just now.
        """
        self._recent.clear()
        self._seen = 0
        self._free_limit = self._healthy_range.free_limit
        self._run_limit = self._healthy_range.run_limit
        if renewed:
            self._free_limit *= RENEWED_FREE
            self._run_limit *= RENEWED_RUN

    def see(self, latents: torch.Tensor) -> None:
        """Take in the (B, P, L) pooled latents of one look.

        Of several environments the worst counts.

        Raises SensorError: farther from healthy units than any of them was; FreeAirError at the
        start of an episode.
        """
        if not self.active:
            return
        if self._calibration_map is not None:
            latents = self._calibration_map(latents)
        free, run = self.judge(float(self._healthy_range.distance(latents).max()))
        if free > 1:
            do = (
                "Let go of everything and take the reference again; "
                "look whether the camera or gel has moved."
            )
            raise FreeAirError(self._message("in free air", self._free_limit, free, do))
        if run > 1:
            do = "Look at the sensor; monitor=off goes on without this check."
            raise SensorError(self._message("over half a second", self._run_limit, run, do))

    @property
    def health(self) -> float:
        """Mean distance of the recent readings over the largest allowed one.

        NaN before the first.
        """
        if not self._recent:
            return float("nan")
        return sum(self._recent) / len(self._recent) / self._run_limit

    def judge(self, distance: float) -> tuple[float, float]:
        """Return the mean distance over its limit in free air and over half a second.

        0 while that isn't due.
        """
        self._recent.append(distance)
        self._seen += 1
        mean = sum(self._recent) / len(self._recent)
        free = run = 0.0
        if self._free_air and self._seen == FREE_LOOKS:
            free = mean / self._free_limit
        if len(self._recent) == self._recent.maxlen:
            run = mean / self._run_limit
        return free, run

    def _message(self, when: str, limit: float, times: float, do: str) -> str:
        what = f"{self._healthy_range.kind} on the {self._finger} finger {when}"
        return expected(
            what, f"latents within {limit:.2f} of healthy units", f"{times * limit:.2f}", do
        )
