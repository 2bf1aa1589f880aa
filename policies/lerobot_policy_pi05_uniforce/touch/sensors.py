"""A policy's force sensors: one for each touch slot, from its settings and frozen networks."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from lerobot_policy_pi05_uniforce.touch.encoder import FrozenTouch
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.force_sensor import HALF_SECOND, ForceSensor, monitor_of
from uniforce_vtla.keys import AXES
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer.api import shipped_sizes
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.latent_range import FREE_LOOKS, HealthMonitor
from uniforce_vtla.tokenizer.newtons import FZ, Lift
from uniforce_vtla.tokenizer.weights import checkpoint_folder

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig

logger = logging.getLogger(__name__)
HEIGHT = AXES.index("z.pos")


class PolicySensors:
    """The force sensors of a policy's slots.

    Attributes:
        by_slot: slot → sensor of the finger that fills it.
        other: sensor of the finger beside the first slot's, whose grip is compared; None without slots.
        notes: a sentence about each grip that is held.
    """

    def __init__(self, config: PI05UniforceConfig, frozen: FrozenTouch) -> None:
        shape = config.tokens_per_slot, config.latent_size
        calibrations = load_calibrations(config, shape)
        held_N: dict[str, float] = {}
        self.notes: list[str] = []
        if frozen.force_head is not None:
            held_N, self.notes = held_grips(config, calibrations)
        self.by_slot: dict[str, ForceSensor] = {}
        self.other: ForceSensor | None = None

        def sensor(finger: Finger, held_N: float | None = None) -> ForceSensor:
            return ForceSensor(
                "",
                finger,
                calibration=calibrations.get(finger),
                tokenizer=frozen.tokenizer,
                head=frozen.force_head,
                held_N=held_N,
                grid=config.latent_grid,
            )

        fingers = config.finger_by_slot()
        for slot in config.slots:
            finger = fingers[slot]
            self.by_slot[slot] = sensor(finger, held_N.get(slot))
            self.by_slot[slot].monitor = make_monitor(config, slot, calibrations.get(finger))
            if self.other is None:
                beside = next(one for one in FINGERS if one != finger)
                self.other = sensor(beside)


def load_calibrations(
    config: PI05UniforceConfig, shape: tuple[int, int]
) -> dict[Finger, Calibration]:
    """Return finger → calibration onto the (rows, numbers) that the policy knows, where one is named.

    Raises CheckpointError: made for another tokenizer, head or kind of sensor, of other sizes than this
    policy's input, or a gain of newtons where it feels none.
    """
    found: dict[Finger, Calibration] = {}
    for finger in FINGERS:
        folder = getattr(config, f"{finger}_calibration")
        if not folder:
            continue
        calibration = Calibration.load(folder, config.tokenizer_hash)
        came = calibration.map.patches, calibration.map.latent
        if came != shape:
            do = "Calibrate with this version."
            raise CheckpointError(expected(f"latents of {folder}", shape, came, do))
        _check_kind(config, finger, calibration)
        _check_gain(config, finger, calibration)
        logger.info(
            "%s finger: calibration of %s against %s", finger, calibration.new, calibration.anchor
        )
        calibration.map.to(config.device)
        found[finger] = calibration
    return found


def _check_kind(config: PI05UniforceConfig, finger: Finger, calibration: Calibration) -> None:
    """Refuse the calibration of another kind of sensor than the finger wears."""
    made_of = calibration.new.partition("+")[0].partition(":")[0]
    kind = getattr(config, f"{finger}_sensor")
    if kind and made_of in list_sensors() and made_of != kind:
        do = "Calibrate the sensor that the finger wears."
        came = f"one of {calibration.new}"
        raise CheckpointError(expected(f"{finger}_calibration", f"one of a {kind}", came, do))


def _check_gain(config: PI05UniforceConfig, finger: Finger, calibration: Calibration) -> None:
    """Refuse a gain of newtons that another head reads, or none."""
    head = config.touch.head_hash if config.touch.input == "newtons" else ""
    if calibration.gain == 1 or calibration.head_hash == head:
        return
    wanted = "a map: this policy feels no newtons"
    if head:
        wanted = f"a gain of newtons that head {head[:12]} reads"
    came = f"a gain of those of head {calibration.head_hash[:12]}"
    do = "Calibrate by pairs with fit.gain=false, or with this policy's head."
    raise CheckpointError(expected(f"{finger}_calibration", wanted, came, do))


def make_monitor(
    config: PI05UniforceConfig, slot: str, calibration: Calibration | None
) -> HealthMonitor | None:
    """Return the health monitor of a slot's sensor; None where it isn't known, or has no range."""
    size = shipped_sizes().get(config.tokenizer_hash) if config.tokenizer_hash else None
    finger = config.finger_by_slot()[slot]
    kind = getattr(config, f"{finger}_sensor") or config.touch.trained_sensors.get(slot, "")
    if config.monitor == "off" or size is None or not kind:
        return None
    if not checkpoint_folder(size, f"latent_range_{kind}").is_dir():
        logger.info(
            "%s finger (%s): no range of latents is shipped, it isn't watched", finger, kind
        )
        return None
    readings = max(FREE_LOOKS, round(HALF_SECOND / config.n_action_steps))
    return monitor_of(kind, finger, size, readings, calibration)


def held_grips(
    config: PI05UniforceConfig, calibrations: Mapping[Finger, Calibration]
) -> tuple[dict[str, float], list[str]]:
    """Return slot → grip to hold in N, and a sentence about each; by ``config.grip``, or as calibrations say.

    Raises ContractError: it is to be held, and the checkpoint doesn't know what demonstrations read.
    """
    found: dict[str, float] = {}
    notes: list[str] = []
    for slot, finger in config.finger_by_slot().items():
        calibration = calibrations.get(finger)
        can_read = calibration is None or calibration.reads_grip
        if config.grip == "read" or (config.grip == "" and can_read):
            continue
        carried_N = config.touch.carried_N.get(slot)
        if carried_N is None and config.grip == "held":
            do = "Train it again from a view of this version, or leave grip as read."
            wanted = "one in touch.carried_N"
            raise ContractError(expected(f"grip of {slot} to hold", wanted, "none", do))
        if carried_N is None:
            logger.warning(
                "%s finger: grip can't be read and the checkpoint has none to hold; taken as read",
                finger,
            )
            continue
        found[slot] = carried_N
        why = "as asked"
        if config.grip != "held" and calibration is not None:
            why = calibration.grip_in_words
        held = f"shear felt, grip held at {carried_N:.1f} N once lifted"
        notes.append(f"{finger} finger: {held} ({why})")
        logger.warning("%s", notes[-1])
    return found, notes


def carried_grip(episodes: Iterable[tuple[Tensor, Tensor]]) -> float | None:
    """Return the median grip over demonstrations while something is lifted, N; None where nothing is.

    Each episode is the measured state (T, axes) and the finger's newtons (T, 3).
    """
    grips: list[Tensor] = []
    for state, force_N in episodes:
        lift = Lift()
        lifted = []
        for height_m, grip_N in zip(
            state[:, HEIGHT].split(1), force_N[:, FZ].split(1), strict=True
        ):
            lifted.append(lift.see(height_m, grip_N))
        grips.append(force_N[:, FZ][torch.cat(lifted)])
    every = torch.cat(grips) if grips else torch.zeros(0)
    return float(every.median()) if len(every) else None
