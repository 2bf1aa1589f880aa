"""A policy's force sensors: one for each touch slot, from its settings and frozen networks."""

from __future__ import annotations

import logging

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.touch.encoder import FrozenTokenizer
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.force_sensor import HALF_SECOND, ForceSensor, monitor_of
from uniforce_vtla.tokenizer.api import shipped_sizes
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.latent_range import FREE_LOOKS, HealthMonitor
from uniforce_vtla.tokenizer.weights import checkpoint_folder

logger = logging.getLogger(__name__)
# control steps in which no hand grasps: one second. A policy that looks less often isn't judged in
# free air, since its third look may see the tool held
UNTOUCHED_STEPS = 30


def policy_sensors(
    config: PI05UniforceConfig, frozen: FrozenTokenizer | None
) -> dict[str, ForceSensor]:
    """Return slot → sensor of the finger that fills it; none without frozen networks."""
    if frozen is None:
        return {}
    calibrations = load_calibrations(config)
    fingers = config.finger_by_slot()
    found = {}
    for slot in config.slots:
        finger = fingers[slot]
        calibration = calibrations.get(finger)
        sensor = ForceSensor(
            "",
            finger,
            calibration=calibration,
            tokenizer=frozen.tokenizer,
            head=frozen.force_head,
            grid=config.latent_grid,
        )
        sensor.monitor = make_monitor(config, slot, calibration)
        found[slot] = sensor
    return found


def load_calibrations(config: PI05UniforceConfig) -> dict[Finger, Calibration]:
    """Return finger → calibration onto the latents that the policy knows, where one is named.

    Raises CheckpointError: made for another tokenizer or type of sensor, or of other sizes than
    this policy's latents.
    """
    shape = config.tokens_per_slot, config.latent_size
    found = {}
    for finger in FINGERS:
        folder = getattr(config, f"{finger}_calibration")
        if not folder:
            continue
        calibration = Calibration.load(folder, config.tokenizer_hash)
        came = calibration.map.patches, calibration.map.latent
        if came != shape:
            do = "Calibrate with this version."
            raise CheckpointError(expected(f"latents of {folder}", shape, came, do))
        calibration.check_fits(getattr(config, f"{finger}_sensor"), finger)
        logger.info(
            "%s finger: calibration of %s against %s", finger, calibration.new, calibration.anchor
        )
        calibration.map.to(config.device)
        found[finger] = calibration
    return found


def make_monitor(
    config: PI05UniforceConfig, slot: str, calibration: Calibration | None
) -> HealthMonitor | None:
    """Return the health monitor of a slot's sensor; None where no range is known for it."""
    size = shipped_sizes().get(config.tokenizer_hash)
    finger = config.finger_by_slot()[slot]
    kind = getattr(config, f"{finger}_sensor") or config.touch.trained_sensors.get(slot, "")
    if config.monitor == "off" or size is None or not kind:
        return None
    if not checkpoint_folder(size, f"latent_range_{kind}").is_dir():
        message = "%s finger (%s): no range of latents is shipped, it isn't watched"
        logger.info(message, finger, kind)
        return None
    readings = max(FREE_LOOKS, round(HALF_SECOND / config.n_action_steps))
    free_air = FREE_LOOKS * config.n_action_steps <= UNTOUCHED_STEPS
    return monitor_of(kind, finger, size, readings, calibration, free_air)
