"""What must agree between a checkpoint and what runs it, and what is mere provenance."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import CheckpointError, expected

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class TouchFacts:
    """The seam between tokenizer and policy: two sides with equal facts fit together."""

    slots: tuple[str, ...]
    touch_input: str
    num_patches: int
    latent_size: int
    latent_grid: int
    token_site: str
    tokenizer_hash: str

    @classmethod
    def of(cls, config: PI05UniforceConfig | dict[str, Any]) -> TouchFacts:
        """Read the facts from a live config or from a saved ``config.json``."""
        read = config.get if isinstance(config, dict) else lambda name: getattr(config, name)
        values: dict[str, Any] = {f.name: read(f.name) for f in fields(cls) if f.name != "slots"}
        return cls(slots=tuple(sorted(read("touch_slots") or ())), **values)


def check_same(saved: TouchFacts, running: TouchFacts) -> None:
    """Raise CheckpointError naming every fact that differs between a checkpoint and the running config."""
    differing = [f.name for f in fields(TouchFacts) if getattr(saved, f.name) != getattr(running, f.name)]
    if differing:
        wanted = {name: getattr(saved, name) for name in differing}
        came = {name: getattr(running, name) for name in differing}
        do = "Run the checkpoint with its own tokenizer and slots; only swap and sensors may change."
        raise CheckpointError(expected("touch settings", wanted, came, do))


def check_sensors(config: PI05UniforceConfig, mounted: Mapping[Finger, str]) -> list[str]:
    """Compare the sensors a robot or environment wears with those the policy was trained on.

    Args:
        config: the policy's config; ``swap`` or ``left_sensor``/``right_sensor`` ask for a change.
        mounted: finger → kind of sensor worn now.

    Returns:
        One line per slot that runs on another kind than it was trained on; log and store them.

    Raises:
        CheckpointError: a slot's sensor differs and nobody asked for that.
    """
    notes = []
    for slot, finger in config.finger_by_slot().items():
        trained, worn = config.trained_sensors.get(slot, ""), mounted.get(finger, "")
        if not trained or not worn or worn in trained.split("+"):
            continue
        asked = (
            config.mounted_sensors[finger] == worn
            or config.finger_by_slot()[slot] != config.touch_slots[slot]
        )
        if not asked:
            do = f"Say swap={slot}:FINGER or {finger}_sensor={worn} if you mean it."
            raise CheckpointError(expected(f"sensor of {slot} ({finger} finger)", trained, worn, do))
        notes.append(f"{slot}: trained on {trained}, now {worn} on the {finger} finger")
        logger.warning("Sensor swap, as asked: %s", notes[-1])
    return notes
