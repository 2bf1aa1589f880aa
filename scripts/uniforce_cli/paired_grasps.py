"""Pairs for a calibration: latents of both fingers on the same contacts, simulated or recorded."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

from uniforce_vtla.errors import DatasetError, SensorError, expected
from uniforce_vtla.options import split

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from uniforce_vtla.contact.worn import WornView
    from uniforce_vtla.contracts import ContactState, Finger
    from uniforce_vtla.tokenizer.api import Tokenizer
    from uniforce_vtla.tokenizer.latent import Latent
    from uniforce_vtla.tokenizer.mount_relation import Mount

    # reference (480, 640), marker images (B, 480, 640), finger
    Seen = tuple[np.ndarray, np.ndarray, Finger]
    # reference (480, 640), marker images (B, 480, 640), finger → (B, P, L)
    Encode = Callable[[np.ndarray, np.ndarray, Finger], Latent]

TOOL_TORSION_ARM_mm = 9.0  # a held tool twists flat pads so far
BATCH = 32
# Recorded pairs that count as one grasp: the layout doesn't store where a grasp ends. `uniforce
# pairs` keeps some 25 pairs of a grasp, so that stretches of 50 cut few grasps in two.
STRETCH = 50
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Grasps:
    """Pooled latents (n, P, L) of both fingers on the same grasps, and what was grasped."""

    new: Latent
    anchor: Latent
    classes: tuple[str, ...]
    numbers: tuple[int, ...]  # of the grasp that a row is of


def simulated_grasps(new: str, anchor: str, count: int, seed: int, encode: Encode) -> Grasps:
    """Grasp in simulation, the new sensor left, the anchor right.

    Half small objects, half tools, at rest.
    """
    import numpy as np
    import torch

    from uniforce_vtla.contact.indenters import PRETRAIN
    from uniforce_vtla.contact.sampling import FLAT, ForceRange, sample_loads, sample_objects
    from uniforce_vtla.contact.worn import WornView
    from uniforce_vtla.contact.worn_in_words import wear
    from uniforce_vtla.contracts import ContactState
    from uniforce_vtla.markers.mirror import mirrored

    rng = np.random.default_rng([seed, 55])
    objects = sample_objects(rng, count, PRETRAIN, flat_share=0.5)
    bounds = ForceRange(flat_torsion_arm_mm=TOOL_TORSION_ARM_mm)
    force, torsion = sample_loads(rng, count, bounds, objects.names)
    contact = ContactState(objects.gap_mm, force, torsion)
    left = seen(WornView(wear(new)(seed), seed), contact, "left", encode)
    right = seen(WornView(wear(anchor)(seed), seed + 1), mirrored(contact), "right", encode)
    both = sorted(left.keys() & right.keys())
    left_out = count - len(both)
    if not both:
        came = f"none of {count}: a finger's frame was always refused"
        raise SensorError(expected("grasps", "frames that can be read", came, f"Check {new}."))
    if left_out:
        logger.warning(
            "%d of %d grasps are left out: a finger's frame was refused", left_out, count
        )
    return Grasps(
        new=torch.stack([left[row] for row in both]),  # type: ignore[arg-type]  # keeps the origin
        anchor=torch.stack([right[row] for row in both]),  # type: ignore[arg-type]
        classes=tuple("tool" if objects.names[row] == FLAT else "small" for row in both),
        numbers=tuple(both),
    )


def seen(
    view: WornView, contact: ContactState, finger: Finger, encode: Encode
) -> dict[int, Latent]:
    """Return row → latent (P, L) of a contact as a unit shows it; refused frames are left out."""
    import numpy as np

    from uniforce_vtla.contact.simulator import rows_of, slices

    found: dict[int, Latent] = {}
    for part in slices(len(contact.gap_mm), BATCH):
        images = view.accepted(rows_of(contact, part))
        if not images:
            continue
        latents = encode(view.reference, np.stack(list(images.values())), finger)
        for row, latent in zip(images, latents, strict=True):
            found[part.start + row] = latent
    return found


def recorded_grasps(
    folder: str, new: str, anchor: str, tools: str, tokenizer: Tokenizer, mounted: Mount = "upright"
) -> Grasps:
    """Read recorded pairs of the two sensors; of one kind the new one is the left.

    The new sensor's images are brought upright where ``mounted`` says that they were recorded
    otherwise.

    Raises DatasetError: as ``read_uniforce_pairs``, or pairs of other sensors.
    """
    import numpy as np
    import torch

    from uniforce_datasets.readers.uniforce_pairs import read_uniforce_pairs
    from uniforce_robots.sensors.config_uniforce import Orientation
    from uniforce_vtla.tokenizer.mount_relation import SETTINGS

    upright = Orientation(*SETTINGS[mounted]).of_frame
    new_kind = new.partition(":")[0]
    kinds = {new_kind, anchor.partition(":")[0]}
    of_new: list[Latent] = []
    of_anchor: list[Latent] = []
    classes: list[str] = []
    stretches: dict[tuple[str, str, int], int] = {}
    numbers: list[int] = []
    for recording in read_uniforce_pairs(folder):
        if set(recording.kinds) != kinds:
            do = "Name them new= and anchor=."
            came = recording.kinds
            raise DatasetError(expected(f"sensors of {recording}", sorted(kinds), came, do))
        left: Seen = (recording.left_reference, recording.left_frames, "left")
        right: Seen = (recording.right_reference, recording.right_frames, "right")
        is_left = recording.kinds[0] == new_kind
        reference, frames, finger = left if is_left else right
        turned = np.stack([upright(frame) for frame in frames])
        of_new.append(tokenizer.pooled(upright(reference), turned, finger))
        of_anchor.append(tokenizer.pooled(*(right if is_left else left)))
        kind = "tool" if recording.indenter in split(tools) else "small"
        count = len(recording.left_frames)
        classes += [kind] * count
        for frame in range(recording.first_frame, recording.first_frame + count):
            stretch = (recording.name, recording.indenter, frame // STRETCH)
            numbers.append(stretches.setdefault(stretch, len(stretches)))
    return Grasps(
        new=torch.cat(of_new),  # type: ignore[arg-type]  # keeps the origin
        anchor=torch.cat(of_anchor),  # type: ignore[arg-type]
        classes=tuple(classes),
        numbers=tuple(numbers),
    )
