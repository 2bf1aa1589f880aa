"""The network's input of each touch slot, from stored latents, marker images or the true wrench."""

import logging
from typing import Any

import torch
from torch import Tensor

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import MEASURED_STATE
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import RolloutError, SensorError, UniForceError, expected
from uniforce_vtla.force_sensor import ForceSensor
from uniforce_vtla.keys import AXES, STATE, latent_key, tactile_key, wrench_key
from uniforce_vtla.tokenizer.latent_range import FreeAirError

logger = logging.getLogger(__name__)

type Batch = dict[str, Tensor]

# reference, current
PAIR_KEYS = {finger: (tactile_key(finger, True), tactile_key(finger)) for finger in FINGERS}
WIDTH = AXES.index("width.pos")
OPEN_m = 0.004  # below its widest command: the measured width lags behind


class TouchInput:
    """Turns a batch into one (B, rows, numbers) tensor (``config.touch_shape``) and mask per slot.

    Args:
        config: settings of the policy.
        sensors: slot → its sensor; none where the input isn't felt by sensors.
    """

    def __init__(self, config: PI05UniforceConfig, sensors: dict[str, ForceSensor]) -> None:
        self.config = config
        self.sensors = sensors
        self.hidden: set[Finger] = set()  # whose touch is taken away from a trained policy
        # references taken in this episode instead of those given
        self._renewed: dict[str, Tensor] = {}
        self._unhealthy: set[str] = set()  # slots masked until the episode ends
        self._logged: set[tuple[str, str]] = set()

    def reset(self) -> None:
        """Start an episode: forget references and earlier readings."""
        self._renewed.clear()
        self._unhealthy.clear()
        for sensor in self.sensors.values():
            sensor.reset()

    def to(self, device: torch.device) -> None:
        """Move what is no module of the policy: calibrations and health ranges."""
        for sensor in self.sensors.values():
            sensor.to(device)

    def gather(self, batch: Batch, training: bool, watched: bool = True) -> tuple[Any, Any]:
        """Return (slots, B, rows, numbers) and (slots, B) whether each is there, or None.

        ``watched``: the batch is a look of a rollout, so that sensors' health is judged.

        Raises, if ``on_sensor_loss`` is "error", RolloutError: a declared input is missing or not
        finite; SensorError: latents outside the range of healthy sensors.
        """
        for sensor in self.sensors.values():
            if sensor.monitor is not None:
                sensor.monitor.active = watched and not training
        if not self.config.slots:
            return None, None
        touches = torch.stack([self._read(batch, slot) for slot in self.config.slots])
        masks = touches.isfinite().flatten(2).all(dim=2)
        if training:
            share = torch.rand_like(masks, dtype=torch.float32)
            masks = masks & (share >= self.config.augment.touch_dropout)
        return touches.nan_to_num(), masks

    def _read(self, batch: Batch, slot: str) -> Tensor:
        """Return a slot's input, NaN where its sensor is lost or its finger hidden."""
        if slot in self._unhealthy or self.config.finger_by_slot()[slot] in self.hidden:
            return self._nothing(batch)
        try:
            touch = self.read(batch, slot)
        except (RolloutError, SensorError) as error:
            self._lost(slot, error)
            if isinstance(error, FreeAirError):  # it is judged once, and the fault stays
                self._unhealthy.add(slot)
            return self._nothing(batch)
        if not touch.isfinite().all():
            do = "Check the sensor or the dataset."
            self._lost(slot, RolloutError(expected(slot, "finite numbers", "NaN or inf", do)))
        return touch

    def _lost(self, slot: str, error: UniForceError) -> None:
        if self.config.touch.on_sensor_loss == "error":
            raise error
        kind = (slot, type(error).__name__)
        if kind not in self._logged:
            self._logged.add(kind)
            logger.warning("on_sensor_loss=mask: going on without touch. %s", error)

    @torch.no_grad()
    def read(self, batch: Batch, slot: str) -> Tensor:
        """Return a slot's (B, K, L) latents, or (B, 1, numbers) of the newtons read in them.

        Raises RolloutError where its sensor is lost.
        """
        if self.config.touch.input == "wrench":
            return taken(batch, wrench_key(slot)).float()[:, None]
        latent = self._latent(batch, slot)
        if not self.config.reads_newtons:
            return latent
        return self.sensors[slot].newtons(latent)[:, None]  # (B, 1, 3)

    def _nothing(self, batch: Batch) -> Tensor:
        """Return a slot's input of which no number is known."""
        state = batch[STATE]
        return state.new_full((len(state), *self.config.touch_shape), torch.nan)

    def _latent(self, batch: Batch, slot: str) -> Tensor:
        """Return a slot's (B, K, L) latents; those of a demonstration aren't calibrated."""
        key = latent_key(slot)
        if key not in batch:
            return self._encoded(batch, slot)
        latent = batch[key].float()
        return latent.reshape(len(latent), self.config.tokens_per_slot, -1)

    def _encoded(self, batch: Batch, slot: str) -> Tensor:
        """Return latents of a slot's marker images; an open hand takes a new reference once."""
        sensor = self.sensors[slot]
        reference, current = marker_images(batch, sensor.finger)
        try:
            return sensor.encode(self._renewed.get(slot, reference), current)
        except FreeAirError as error:
            if slot in self._renewed or not self._hand_is_open(batch):
                raise
            logger.warning("%s finger: a new reference is taken. %s", sensor.finger, error)
            self._renewed[slot] = current
            return sensor.renew(current)

    def _hand_is_open(self, batch: Batch) -> bool:
        """Return whether the hand is as wide as demonstrations commanded; False where unknown."""
        bounds = self.config.action.target_range
        if not bounds or MEASURED_STATE not in batch:
            return False
        return bool((batch[MEASURED_STATE][:, WIDTH] > bounds[1][WIDTH] - OPEN_m).all())


def marker_images(batch: Batch, finger: Finger) -> tuple[Tensor, Tensor]:
    """Return a finger's reference and current marker images, (B, H, W) each."""
    reference_key, current_key = PAIR_KEYS[finger]
    return grey(taken(batch, reference_key)), grey(taken(batch, current_key))


def taken(batch: Batch, key: str) -> Tensor:
    """Return an entry of the batch; RolloutError where it is lost."""
    if key not in batch:
        do = "Check the sensor of that finger."
        raise RolloutError(expected(key, "a tensor in the observation", "none", do))
    return batch[key]


def grey(images: Tensor) -> Tensor:
    """Return (B, H, W) from (B, H, W) or (B, 3, H, W), RGB copies of one binary channel."""
    return images[:, 0] if images.ndim == 4 else images
