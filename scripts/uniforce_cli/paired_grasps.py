"""Pairs for a calibration: both fingers' latents of the same contacts, of simulated or recorded grasps, or of wipes."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.options import split

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from uniforce_datasets.source import Episode
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
# Recorded pairs that count as one grasp: the layout doesn't store where a grasp ends. `uniforce pairs` keeps some 25
# pairs of a grasp, so that stretches of 50 cut few grasps in two.
STRETCH = 50
EVERY = 4  # frames of a recorded wipe, of which one is read: neighbours show the same
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Grasps:
    """Pooled latents (n, P, L) of both fingers on the same grasps, and what was grasped."""

    new: Latent
    anchor: Latent
    classes: tuple[str, ...]
    numbers: tuple[int, ...]  # of the grasp that a row is of


def simulated_grasps(new: str, anchor: str, count: int, seed: int, encode: Encode) -> Grasps:
    """Grasp in simulation, the new sensor left and the anchor right: half small objects, half tools, at rest."""
    import numpy as np
    import torch

    from uniforce_vtla.contact.indenters import PRETRAIN
    from uniforce_vtla.contact.sampling import FLAT, ForceRange, sample_loads, sample_objects
    from uniforce_vtla.contact.worn import WornView
    from uniforce_vtla.contact.worn_in_words import wear
    from uniforce_vtla.contracts import ContactState
    from uniforce_vtla.markers.mirror import mirrored

    worn_new, worn_anchor = (wear(words)(seed) for words in (new, anchor))
    rng = np.random.default_rng([seed, 55])
    objects = sample_objects(rng, count, PRETRAIN, flat_share=0.5)
    force, torsion = sample_loads(
        rng, count, ForceRange(flat_torsion_arm_mm=TOOL_TORSION_ARM_mm), objects.names
    )
    contact = ContactState(objects.gap_mm, force, torsion)
    left = seen(WornView(worn_new, seed), contact, "left", encode)
    right = seen(WornView(worn_anchor, seed + 1), mirrored(contact), "right", encode)
    both = sorted(left.keys() & right.keys())
    if left_out := count - len(both):
        logger.warning(
            "%d of %d grasps are left out: a finger's frame was refused", left_out, count
        )
    classes = tuple("tool" if objects.names[row] == FLAT else "small" for row in both)
    of_new, of_anchor = (torch.stack([of[row] for row in both]) for of in (left, right))
    return Grasps(of_new, of_anchor, classes, tuple(both))  # type: ignore[arg-type]  # stack keeps the origin


def seen(
    view: WornView, contact: ContactState, finger: Finger, encode: Encode
) -> dict[int, Latent]:
    """Return row → what ``encode`` makes of a contact as a worn unit shows it, (P, L); refused frames are left out."""
    import numpy as np

    from uniforce_vtla.contact.simulator import rows_of, slices

    found: dict[int, Latent] = {}
    for part in slices(len(contact.gap_mm), BATCH):
        if images := view.accepted(rows_of(contact, part)):
            latents = encode(view.reference, np.stack(list(images.values())), finger)
            found |= {part.start + row: latent for row, latent in zip(images, latents, strict=True)}
    return found


def recorded_grasps(
    folder: str, new: str, anchor: str, tools: str, tokenizer: Tokenizer, mounted: Mount = "upright"
) -> Grasps:
    """Read recorded pairs of the two sensors; either finger may wear the new one, of one kind it is the left.

    Its images are brought upright if ``mounted`` says that they were recorded otherwise.

    Raises DatasetError: as ``read_uniforce_pairs``, or pairs of other sensors.
    """
    import numpy as np
    import torch

    from uniforce_datasets.readers.uniforce_pairs import read_uniforce_pairs
    from uniforce_robots.sensors.config_uniforce import Orientation
    from uniforce_vtla.tokenizer.mount_relation import SETTINGS

    upright = Orientation(*SETTINGS[mounted]).of_frame
    new_name, anchor_name = (words.partition(":")[0] for words in (new, anchor))
    encode = tokenizer.pooled
    of_new: list[Latent] = []
    of_anchor: list[Latent] = []
    classes: list[str] = []
    stretches: dict[tuple[str, str, int], int] = {}
    numbers: list[int] = []
    for recording in read_uniforce_pairs(folder):
        if set(recording.kinds) != {new_name, anchor_name}:
            do = "Name them new= and anchor=."
            raise DatasetError(
                expected(f"sensors of {recording}", [new_name, anchor_name], recording.kinds, do)
            )
        left: Seen = (recording.left_reference, recording.left_frames, "left")
        right: Seen = (recording.right_reference, recording.right_frames, "right")
        is_left = recording.kinds[0] == new_name
        reference, frames, finger = left if is_left else right
        of_new.append(
            encode(upright(reference), np.stack([upright(frame) for frame in frames]), finger)
        )
        of_anchor.append(encode(*(right if is_left else left)))
        kind = "tool" if recording.indenter in split(tools) else "small"
        classes += [kind] * len(recording.left_frames)
        for frame in range(
            recording.first_frame, recording.first_frame + len(recording.left_frames)
        ):
            stretch = recording.name, recording.indenter, frame // STRETCH
            numbers.append(stretches.setdefault(stretch, len(stretches)))
    return Grasps(torch.cat(of_new), torch.cat(of_anchor), tuple(classes), tuple(numbers))  # type: ignore[arg-type]  # cat keeps the origin


def recorded_wipes(
    folder: str, new: str, anchor: str, finger: Finger, tokenizer: Tokenizer
) -> tuple[Latent, Latent]:
    """Read a dataset of wipes in which ``finger`` wears the kind ``new`` and the other one ``anchor``.

    Returns the pooled latents (n, P, L) of the new sensor and of the anchor at the same moments.

    Raises DatasetError: as ``check_dataset``, or fingers that wear others; SensorError: a reference that can't be read.
    """
    import torch

    from uniforce_datasets.lossless import check_dataset
    from uniforce_datasets.view_plan import episode_facts

    source = check_dataset(folder)
    other: Finger = "left" if finger == "right" else "right"
    encode = tokenizer.pooled
    latents: dict[Finger, list[Latent]] = {finger: [], other: []}
    for episode, facts in episode_facts(source):
        worn = {"left": facts.left_sensor, "right": facts.right_sensor}
        wanted = {finger: new, other: anchor}
        if worn != wanted:
            do = "Name them new= and anchor=, and the new one's finger=."
            raise DatasetError(
                expected(f"sensors of {folder}, episode {episode.index}", wanted, worn, do)
            )
        for one, found in latents.items():
            found += _encoded(episode, source.fps, one, encode)
    of_new, of_anchor = (torch.cat(latents[one]) for one in (finger, other))
    return of_new, of_anchor  # type: ignore[return-value]  # cat keeps the origin


def _encoded(episode: Episode, fps: int, finger: Finger, encode: Encode) -> list[Latent]:
    """Return the latents of every fourth frame of a finger, in batches."""
    from itertools import batched, islice

    import numpy as np

    from uniforce_datasets.source import episode_frames
    from uniforce_vtla.keys import tactile_key

    span = episode.videos[tactile_key(finger, reference=True)]
    reference = next(episode_frames(span, episode.length, fps))[..., 0]
    current = islice(
        episode_frames(episode.videos[tactile_key(finger)], episode.length, fps), 0, None, EVERY
    )
    images = (frame[..., 0] for frame in current)
    return [encode(reference, np.stack(some), finger) for some in batched(images, BATCH)]
