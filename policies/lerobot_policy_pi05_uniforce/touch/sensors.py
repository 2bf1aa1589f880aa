"""A policy's force sensors: one for each touch slot, from its settings and frozen networks."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping

import torch
from torch import Tensor

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import HELD, PI05UniforceConfig
from lerobot_policy_pi05_uniforce.touch.encoder import FrozenTouch
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.force_sensor import HALF_SECOND, ForceSensor, monitor_of
from uniforce_vtla.keys import AXES
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer.api import shipped_sizes
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.finger_balance import EVERY, FingerBalance, imbalance
from uniforce_vtla.tokenizer.latent_range import FREE_LOOKS, HealthMonitor
from uniforce_vtla.tokenizer.newtons import FZ, Lift
from uniforce_vtla.tokenizer.weights import checkpoint_folder

logger = logging.getLogger(__name__)
HEIGHT = AXES.index("z.pos")


class PolicySensors:
    """The force sensors of a policy's slots.

    Attributes:
        by_slot: slot → sensor of the finger that fills it.
        comparison: of the first slot's finger with the other one; None without slots.
        notes: a sentence about each grip that is held.
    """

    def __init__(self, config: PI05UniforceConfig, frozen: FrozenTouch | None) -> None:
        self.by_slot: dict[str, ForceSensor] = {}
        self.comparison: GripComparison | None = None
        self.notes: list[str] = []
        if frozen is None:
            return
        calibrations = load_calibrations(config)
        held_N: dict[str, float] = {}
        if config.touch.input == "newtons":
            held_N, self.notes = held_grips(config, calibrations)

        def sensor(finger: Finger, held_N: float | None = None) -> ForceSensor:
            return ForceSensor(
                "",
                finger,
                calibration=calibrations.get(finger),
                tokenizer=frozen.tokenizer,
                head=frozen.force_head,
                held_N=held_N,
                held_from_touch=config.grip == "gripped",
                grid=config.latent_grid,
            )

        fingers = config.finger_by_slot()
        for slot in config.slots:
            finger = fingers[slot]
            self.by_slot[slot] = sensor(finger, held_N.get(slot))
            self.by_slot[slot].monitor = make_monitor(config, slot, calibrations.get(finger))
        by_finger = {sensor.finger: sensor for sensor in self.by_slot.values()}
        left, right = FINGERS
        own = self.by_slot[config.slots[0]]
        beside = left if own.finger == right else right
        other = by_finger.get(beside) or sensor(beside)
        self.comparison = GripComparison(own, other, config.n_action_steps)


class GripComparison:
    """Compares the grip that two fingers read, and warns once an episode where they differ.

    Args:
        own: sensor that the policy feels with; nothing is compared where it reads no newtons.
        other: sensor of the finger beside it.
        steps: control steps between two readings of the policy.
    """

    def __init__(self, own: ForceSensor, other: ForceSensor, steps: int) -> None:
        self.own = own
        self.other = other
        self._every = max(1, EVERY // steps)
        self._balance = FingerBalance()
        self.reset()

    def reset(self) -> None:
        """Start an episode."""
        self._balance.reset()
        self._readings = 0

    def is_due(self) -> bool:
        """Count a reading of the policy; return whether it compares."""
        self._readings += 1
        is_due = self._readings % self._every == 0
        return is_due and self.own.newtons is not None and not self._balance.done

    def see(self, latent: Tensor, beside: Tensor) -> None:
        """Take in own and the other finger's calibrated latents, (B, K, L) each."""
        times = self._balance.see(_grip_N(self.own, latent), _grip_N(self.other, beside))
        if times is not None and imbalance(times) > 1:
            message = (
                "%s finger reads %.2f times the other one's grip: one of them is wrong in scale, "
                "calibrate it"
            )
            logger.warning(message, self.own.finger, times)


def _grip_N(sensor: ForceSensor, latent: Tensor) -> float:  # noqa: N802  a unit
    assert sensor.newtons is not None, "is_due() has seen that there is a head"
    return float(sensor.newtons.read(latent)[:, FZ].mean())  # not one that is held


def load_calibrations(config: PI05UniforceConfig) -> dict[Finger, Calibration]:
    """Return finger → calibration onto the latents that the policy knows, where one is named.

    Raises CheckpointError: made for another tokenizer, head or type of sensor, of other sizes than
    this policy's latents, or a gain of newtons where it feels none.
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
        _check_fits(config, finger, calibration)
        logger.info(
            "%s finger: calibration of %s against %s", finger, calibration.new, calibration.anchor
        )
        calibration.map.to(config.device)
        found[finger] = calibration
    return found


def _check_fits(config: PI05UniforceConfig, finger: Finger, calibration: Calibration) -> None:
    """Refuse a calibration of another sensor type, or with a gain for another head's newtons."""
    name = f"{finger}_calibration"
    made_of = calibration.new.partition("+")[0].partition(":")[0]
    kind = getattr(config, f"{finger}_sensor")
    if kind and made_of in list_sensors() and made_of != kind:
        do = "Calibrate the sensor that the finger wears."
        came = f"one of {calibration.new}"
        raise CheckpointError(expected(name, f"one of a {kind}", came, do))
    head = config.touch.head_hash if config.reads_newtons else ""
    if calibration.gain != 1 and calibration.head_hash != head:
        wanted = "a map: this policy feels no newtons"
        if head:
            wanted = f"a gain of newtons that head {head[:12]} reads"
        came = f"a gain of those of head {calibration.head_hash[:12]}"
        do = "Calibrate by pairs with fit.gain=false, or with this policy's head."
        raise CheckpointError(expected(name, wanted, came, do))


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
    return monitor_of(kind, finger, size, readings, calibration)


def held_grips(
    config: PI05UniforceConfig, calibrations: Mapping[Finger, Calibration]
) -> tuple[dict[str, float], list[str]]:
    """Return slot → grip to hold in N, and a sentence about each.

    ``config.grip`` decides, or what the fingers' calibrations can read.

    Raises ContractError: it is to be held, and the demonstrations' grip isn't known.
    """
    found = {}
    notes = []
    for slot, finger in config.finger_by_slot().items():
        calibration = calibrations.get(finger)
        reads_grip = calibration is None or calibration.reads_grip
        if config.grip == "read" or (config.grip == "" and reads_grip):
            continue
        carried_N = config.touch.carried_N.get(slot)
        if carried_N is None:
            if config.grip in HELD:
                do = "Train it again from a view of this version, or leave grip as read."
                wanted = "one in touch.carried_N"
                raise ContractError(expected(f"grip of {slot} to hold", wanted, "none", do))
            message = "grip can't be read and the checkpoint has none to hold; taken as read"
            logger.warning("%s finger: %s", finger, message)
            continue
        found[slot] = carried_N
        why = "as asked"
        if config.grip not in HELD and calibration is not None:
            why = calibration.grip_in_words
        when = "from the first touch on" if config.grip == "gripped" else "once lifted"
        held = f"shear felt, grip held at {carried_N:.1f} N {when}"
        notes.append(f"{finger} finger: {held} ({why})")
        logger.warning("%s", notes[-1])
    return found, notes


def carried_grip(episodes: Iterable[tuple[Tensor, Tensor]]) -> float | None:
    """Return the median grip of demonstrations while something is lifted, N, or None.

    Each episode is the measured state (T, axes) and the finger's newtons (T, 3).
    """
    grips_N = []
    for state, force_N in episodes:
        lift = Lift()
        for height_m, grip_N in zip(state[:, HEIGHT], force_N[:, FZ], strict=True):
            if lift.see(height_m[None], grip_N[None]):
                grips_N.append(grip_N)
    return float(torch.stack(grips_N).median()) if grips_N else None
