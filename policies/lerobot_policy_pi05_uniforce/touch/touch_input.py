"""The network's input of each touch slot: stored latents, or marker images through the slot's force sensor."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import MEASURED_STATE
from lerobot_policy_pi05_uniforce.touch.comparison import GripComparison
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import RolloutError, SensorError, UniForceError, expected
from uniforce_vtla.keys import AXES, SLOTS, latent_key, tactile_key
from uniforce_vtla.tokenizer.latent_range import FreeAirError

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
    from lerobot_policy_pi05_uniforce.touch.sensors import PolicySensors
    from uniforce_vtla.force_sensor import ForceSensor

logger = logging.getLogger(__name__)

LATENT_KEYS = {slot: latent_key(slot) for slot in SLOTS}
# reference, current
PAIR_KEYS = {finger: (tactile_key(finger, True), tactile_key(finger)) for finger in FINGERS}
HEIGHT = AXES.index("z.pos")
WIDTH = AXES.index("width.pos")
OPEN_m = 0.004  # below its widest command: the measured width lags behind


class TouchInput:
    """Turns a batch into one (B, rows, numbers) tensor (``shape``) and one (B,) mask per slot.

    Args:
        config: settings of the policy.
        shape: (rows, numbers) of a slot's input.
        sensors: those of the slots; None where the input isn't felt by sensors.
    """

    def __init__(
        self,
        config: PI05UniforceConfig,
        shape: tuple[int, int],
        sensors: PolicySensors | None = None,
    ) -> None:
        self.config = config
        self.shape = shape
        self.sensors: dict[str, ForceSensor] = {} if sensors is None else sensors.by_slot
        self.notes: list[str] = [] if sensors is None else sensors.notes
        self.masked = False  # every slot hidden: takes touch away from a trained policy
        self._comparison: GripComparison | None = None
        if sensors is not None and sensors.other is not None:
            own = next(iter(self.sensors.values()))
            self._comparison = GripComparison(own, sensors.other, config.n_action_steps)
        # references taken in this episode instead of those given
        self._renewed: dict[str, Tensor] = {}
        self._logged: set[str] = set()

    @property
    def is_watched(self) -> bool:
        """Whether the health of any sensor is watched."""
        return any(sensor.monitor is not None for sensor in self.sensors.values())

    def reset(self) -> None:
        """Start an episode: forget references and earlier readings."""
        self._renewed.clear()
        for sensor in self.sensors.values():
            sensor.reset()
        if self._comparison is not None:
            self._comparison.reset()

    def to(self, device: torch.device) -> None:
        """Move what is no module of the policy: calibrations and health ranges."""
        for sensor in self.sensors.values():
            sensor.to(device)
        if self._comparison is not None:
            self._comparison.other.to(device)

    def gather(
        self, batch: dict[str, Tensor], device: torch.device, training: bool
    ) -> tuple[list[Tensor], list[Tensor]]:
        """Return the slots' tensors and masks, in slot order.

        Raises, if ``on_sensor_loss`` is "error", RolloutError: a declared input is missing or not finite;
        SensorError: latents outside the range of healthy sensors.
        """
        for sensor in self.sensors.values():
            if sensor.monitor is not None:
                sensor.monitor.active = not training
        touches = [self._read(batch, slot, device) for slot in self.config.slots]
        masks = [touch.isfinite().flatten(1).all(dim=1) for touch in touches]  # (B,) each
        if self.masked:
            masks = [torch.zeros_like(mask) for mask in masks]
        if training:
            share = self.config.augment.touch_dropout
            masks = [mask & (torch.rand_like(mask, dtype=torch.float32) >= share) for mask in masks]
        return [touch.nan_to_num() for touch in touches], masks

    def _read(self, batch: dict[str, Tensor], slot: str, device: torch.device) -> Tensor:
        """Return a slot's input, NaN where its sensor is lost."""
        try:
            touch = self.read(batch, slot, device)
        except (RolloutError, SensorError) as error:
            self._lost(error)
            size = len(next(v for k, v in batch.items() if k.startswith("observation.")))
            return torch.full((size, *self.shape), torch.nan, device=device)
        if not bool(touch.isfinite().all()):
            do = "Check the sensor or the dataset."
            self._lost(RolloutError(expected(slot, "finite numbers", "NaN or inf", do)))
        return touch

    def _lost(self, error: UniForceError) -> None:
        if self.config.touch.on_sensor_loss == "error":
            raise error
        message = str(error)
        if message not in self._logged:
            self._logged.add(message)
            logger.warning("on_sensor_loss=mask: going on without touch. %s", message)

    @torch.no_grad()
    def read(self, batch: dict[str, Tensor], slot: str, device: torch.device) -> Tensor:
        """Return a slot's (B, K, latent) latents, or (B, 1, 3) newtons read in them.

        Raises RolloutError where its sensor is lost.
        """
        sensor = self.sensors[slot]
        if LATENT_KEYS[slot] in batch:  # a demonstration's: neither calibrated nor held
            latent = batch[LATENT_KEYS[slot]].to(device, torch.float32)
            latent = latent.reshape(len(latent), self.config.tokens_per_slot, -1)  # (B, K, L)
            if self.config.touch.input == "latent":
                return latent
            assert sensor.newtons is not None
            return sensor.newtons.head.step(latent, None)[0][:, None]
        latent = self._encoded(batch, slot, device)
        if self.config.touch.input == "latent":
            return latent
        height_m = None
        assert sensor.newtons is not None
        if sensor.newtons.held_N is not None:
            height_m = taken(batch, MEASURED_STATE)[:, HEIGHT]
        return sensor.newtons(latent, height_m)[:, None]

    def _encoded(self, batch: dict[str, Tensor], slot: str, device: torch.device) -> Tensor:
        """Return a slot's latents of the marker images; a new reference is taken once in an open hand."""
        sensor = self.sensors[slot]
        reference, current = self._pair(batch, sensor.finger, device)
        try:
            latent = sensor.encode(self._renewed.get(slot, reference), current)
        except FreeAirError as error:
            if slot in self._renewed or not self._hand_is_open(batch):
                raise
            logger.warning("%s finger: a new reference is taken. %s", sensor.finger, error)
            self._renewed[slot] = current
            latent = sensor.renew(current)
        self._compare(batch, slot, latent)
        return latent

    def _compare(self, batch: dict[str, Tensor], slot: str, latent: Tensor) -> None:
        """Compare the first slot's grip with the other finger's, where its pictures are there."""
        comparison = self._comparison
        monitor = self.sensors[slot].monitor
        if comparison is None or monitor is None or not monitor.active:
            return
        if comparison.own is not self.sensors[slot]:
            return
        other = comparison.other.finger
        is_seen = all(key in batch for key in PAIR_KEYS[other])
        if is_seen and comparison.look():
            comparison.see(latent, self._pair(batch, other, latent.device))

    def _hand_is_open(self, batch: dict[str, Tensor]) -> bool:
        """Return whether the hand is as wide as demonstrations ever commanded it; False where unknown."""
        widest = [high[WIDTH] for high in self.config.action.target_range[1:]]
        if not widest or MEASURED_STATE not in batch:
            return False
        return bool((batch[MEASURED_STATE][:, WIDTH] > widest[0] - OPEN_m).all())

    def _pair(
        self, batch: dict[str, Tensor], finger: Finger, device: torch.device
    ) -> tuple[Tensor, Tensor]:
        reference, current = marker_images(batch, finger)
        return reference.to(device), current.to(device)


def marker_images(batch: dict[str, Tensor], finger: Finger) -> tuple[Tensor, Tensor]:
    """Return a finger's reference and current marker images, (B, H, W) each."""
    reference_key, current_key = PAIR_KEYS[finger]
    return grey(taken(batch, reference_key)), grey(taken(batch, current_key))


def taken(batch: dict[str, Tensor], key: str) -> Tensor:
    """Return an entry of the batch; RolloutError where it is lost."""
    if key not in batch:
        do = "Check the sensor of that finger."
        raise RolloutError(expected(key, "a tensor in the observation", "none", do))
    return batch[key]


def grey(images: Tensor) -> Tensor:
    """Return (B, H, W) from (B, H, W) or (B, 3, H, W), RGB copies of one binary channel."""
    return images[:, 0] if images.ndim == 4 else images
