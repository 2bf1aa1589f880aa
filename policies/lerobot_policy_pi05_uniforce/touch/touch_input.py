"""The network's input of each touch slot: cached latents, or marker images encoded now, calibrated and watched."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import MEASURED_STATE
from lerobot_policy_pi05_uniforce.touch.comparison import GripComparison
from lerobot_policy_pi05_uniforce.touch.encoder import packaged_hashes
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import CheckpointError, RolloutError, SensorError, UniForceError, expected
from uniforce_vtla.keys import AXES, SLOTS, latent_key, tactile_key
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.latent_range import (
    FREE_LOOKS,
    FreeAirError,
    HealthMonitor,
    LatentRange,
)
from uniforce_vtla.tokenizer.weights import checkpoint_folder

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig

logger = logging.getLogger(__name__)

LATENT_KEYS = {slot: latent_key(slot) for slot in SLOTS}
# reference, current
PAIR_KEYS = {finger: (tactile_key(finger, True), tactile_key(finger)) for finger in FINGERS}
WIDTH = AXES.index("width.pos")
OPEN_m = 0.004  # of its widest command: what it measures lags behind
HALF_SECOND = 15  # control steps, at 30 Hz


def load_calibrations(
    config: PI05UniforceConfig, shape: tuple[int, int], made_for: str = ""
) -> dict[Finger, Calibration]:
    """Return finger → calibration onto the input (rows, numbers) the policy knows, where its sensor wears one.

    ``made_for`` is a tokenizer's hash, "" the policy's own; or "descriptor".

    Raises CheckpointError: made for another tokenizer, head or kind of sensor, of other sizes than this policy's input,
    or a gain of newtons where it feels none.
    """
    found: dict[Finger, Calibration] = {}
    for finger in FINGERS:
        if folder := getattr(config, f"{finger}_calibration"):
            worn = Calibration.load(folder, made_for or config.tokenizer_hash)
            came = worn.map.patches, worn.map.latent
            if came != shape:
                do = "Calibrate with this version."
                raise CheckpointError(expected(f"latents of {folder}", shape, came, do))
            made_of, kind = (
                worn.new.partition("+")[0].partition(":")[0],
                getattr(config, f"{finger}_sensor"),
            )
            if kind and made_of in list_sensors() and made_of != kind:
                do = "Calibrate the sensor that the finger wears."
                raise CheckpointError(
                    expected(f"{finger}_calibration", f"one of a {kind}", f"one of {worn.new}", do)
                )
            _check_gain(config, finger, worn)
            logger.info(
                "%s finger wears the calibration of %s against %s", finger, worn.new, worn.anchor
            )
            worn.map.to(config.device)
            found[finger] = worn
    return found


def _check_gain(config: PI05UniforceConfig, finger: Finger, worn: Calibration) -> None:
    """Refuse a gain of newtons that another head reads, or none."""
    head = config.touch.head_hash if config.touch.input == "newtons" else ""
    if worn.gain != 1 and worn.head_hash != head:
        wanted = (
            f"a gain of newtons that head {head[:12]} reads"
            if head
            else "a map: this policy feels no newtons"
        )
        came = f"a gain of those of head {worn.head_hash[:12]}"
        do = "Calibrate by pairs with fit.gain=false, or with this policy's head."
        raise CheckpointError(expected(f"{finger}_calibration", wanted, came, do))


def build_monitors(
    config: PI05UniforceConfig, calibrations: dict[Finger, Calibration]
) -> dict[Finger, HealthMonitor]:
    """Return finger → monitor of the sensor it wears, where the policy feels with it and a range is shipped.

    A sensor that is calibrated to a unit of its own kind has to look like that unit: it is judged after the map. A
    finger whose kind isn't known, or has no range, isn't watched; the log says so.
    """
    size = packaged_hashes().get(config.tokenizer_hash) if config.tokenizer_hash else None
    found: dict[Finger, HealthMonitor] = {}
    if config.monitor == "off" or size is None:
        return found
    looks = max(FREE_LOOKS, round(HALF_SECOND / config.n_action_steps))
    for slot, finger in config.finger_by_slot().items():
        kind = getattr(config, f"{finger}_sensor") or config.touch.trained_sensors.get(slot, "")
        if not kind:
            continue  # a policy that is built to be trained: nothing is worn yet
        if checkpoint_folder(size, f"latent_range_{kind}").is_dir():
            worn = calibrations.get(finger)
            within_kind = worn.map if worn and worn.anchor.partition(":")[0] == kind else None
            found[finger] = HealthMonitor(
                LatentRange.from_pretrained(kind, size), finger, looks, within_kind
            )
        else:
            logger.info(
                "%s finger (%s): no range of latents is shipped, it isn't watched", finger, kind
            )
    return found


class TouchInput:
    """Turn a batch into one (B, rows, numbers) tensor (``shape``) and one (B,) mask per slot."""

    def __init__(
        self,
        config: PI05UniforceConfig,
        encoder: Any,
        shape: tuple[int, int],
        calibrations: dict[Finger, Calibration] | None = None,
        monitors: dict[Finger, HealthMonitor] | None = None,
    ) -> None:
        self.config, self.shape = config, shape
        self.monitors = {} if monitors is None else monitors
        # of what is encoded now; cached latents are used as they are
        self.worn = calibrations or {}
        self.encoder: Any = encoder  # TactileEncoder; None where the input is a control's
        self._grips = GripComparison(encoder, self.worn, config.n_action_steps)
        # references taken in this episode instead of those given
        self._renewed: dict[Finger, Tensor] = {}
        self.notes: list[str] = []  # for people who score or roll out: how it feels
        # every slot masked: the control that takes touch away from a trained policy
        self.masked = False
        self._logged: set[str] = set()

    def reset(self) -> None:
        """Forget cached references and what was watched: the next episode takes its own."""
        if self.encoder is not None:
            self.encoder.references.forget()
        self._renewed.clear()
        self._grips.reset()
        for monitor in self.monitors.values():
            monitor.reset()

    def to(self, device: torch.device) -> None:
        """Move the maps of calibrations and the ranges of monitors; ``reset`` forgets what is left elsewhere."""
        for monitor in self.monitors.values():
            monitor.to(device)
        for worn in self.worn.values():
            worn.map.to(device)

    def gather(
        self, batch: dict[str, Tensor], device: torch.device, training: bool
    ) -> tuple[list, list]:
        """Return the slots' tensors and masks, in slot order.

        Raises, if ``on_sensor_loss`` is "error", RolloutError: a declared input is missing or not finite; SensorError:
        a sensor's latents lie outside the range of healthy sensors of its kind.
        """
        for monitor in self.monitors.values():
            monitor.active = not training
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
        if (message := str(error)) not in self._logged:
            self._logged.add(message)
            logger.warning("on_sensor_loss=mask: going on without touch. %s", message)

    def read(self, batch: dict[str, Tensor], slot: str, device: torch.device) -> Tensor:
        """Return a slot's (B, K, latent) latents, cached or encoded now; RolloutError where its sensor is lost."""
        if LATENT_KEYS[slot] in batch:
            latent = batch[LATENT_KEYS[slot]].to(device, torch.float32)
            return latent.reshape(len(latent), *self.shape)
        finger = self.config.finger_by_slot()[slot]
        reference, current = (image.to(device) for image in self.pair(batch, finger))
        latent = self.encoder(slot, finger, self._renewed.get(finger, reference), current)
        if finger in self.monitors:
            try:
                self.monitors[finger].see(latent)
            except FreeAirError as error:
                latent = self._renew(batch, slot, current, error)
        worn = self.worn[finger].map(latent) if finger in self.worn else latent
        if finger in self.monitors:
            self._compare(batch, slot, finger, worn)
        return worn

    def _compare(self, batch: dict[str, Tensor], slot: str, finger: Finger, worn: Tensor) -> None:
        """Compare the first slot's finger with the other one, where its pictures are there."""
        first, other = next(iter(self.config.slots)), next(one for one in FINGERS if one != finger)
        seen = all(key in batch for key in PAIR_KEYS[other])
        if slot == first and seen and self.monitors[finger].active and self._grips.look():
            self._grips.see(
                slot, finger, worn, [image.to(worn.device) for image in self.pair(batch, other)]
            )

    def _renew(
        self, batch: dict[str, Tensor], slot: str, current: Tensor, why: FreeAirError
    ) -> Tensor:
        """Take what an open hand shows now as the reference of this episode, once; return the latents with it."""
        finger = self.config.finger_by_slot()[slot]
        if finger in self._renewed or not self._hand_is_open(batch):
            raise why
        logger.warning("%s finger: a new reference is taken. %s", finger, why)
        self._renewed[finger] = current
        self.monitors[finger].reset(renewed=True)
        return self.encoder(slot, finger, current, current)

    def _hand_is_open(self, batch: dict[str, Tensor]) -> bool:
        """Return whether the hand is as wide as demonstrations ever commanded it; False where that isn't known."""
        widest = [high[WIDTH] for high in self.config.action.target_range[1:]]
        if not widest or MEASURED_STATE not in batch:
            return False
        return bool((batch[MEASURED_STATE][:, WIDTH] > widest[0] - OPEN_m).all())

    def pair(self, batch: dict[str, Tensor], finger: Finger) -> list[Tensor]:
        """Return a finger's reference and current marker images, (B, H, W)."""
        return [grey(taken(batch, key)) for key in PAIR_KEYS[finger]]


def taken(batch: dict[str, Tensor], key: str) -> Tensor:
    """Return an entry of the batch; RolloutError where it is lost."""
    if key not in batch:
        do = "Check the sensor of that finger."
        raise RolloutError(expected(key, "a tensor in the observation", "none", do))
    return batch[key]


def grey(images: Tensor) -> Tensor:
    """Return (B, H, W) from (B, H, W) or (B, 3, H, W), RGB copies of one binary channel."""
    return images[:, 0] if images.ndim == 4 else images
