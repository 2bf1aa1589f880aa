"""How many newtons does a policy misread when another finger fills its slot?  A minute instead of hours of rollouts."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import default_collate
from tqdm import tqdm

from benchmarks.force_misreading import (
    SITUATIONS,
    Changes,
    Misreading,
    Response,
    misreading,
    response,
)
from lerobot_policy_pi05_uniforce.controller import stored_config, stored_policy
from uniforce_cli.boundary import command
from uniforce_datasets.training_view import TrainingView
from uniforce_datasets.view_plan import read_marker
from uniforce_vtla.array_file import read_array
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import CheckpointError, DatasetError, expected
from uniforce_vtla.keys import ACTION, AXES, CAMERAS, STATE, TASK, camera_key, latent_key, truth_wrench_key
from uniforce_vtla.options import Count, OutFile, PolicyFolder, Seed, View
from uniforce_vtla.results_file import provenance, write_json

HEIGHT_AND_WIDTH = [AXES.index("z.pos"), AXES.index("width.pos")]
BATCH = 64  # moments at a time

Sample = dict[str, Any]


@dataclass
class PolicyReadingConfig:
    """Give a policy the touch of its other finger at recorded moments and write how far it misreads forces.

    Asked for while closing, carrying and wiping; how strongly it answers its own finger stands beside how the demos do.
    Needs simulated demos (the true wrench) and a policy with one slot that feels latents. Not a score: a policy that
    reads well may still wipe badly.

    Example: python -m benchmarks.policy_reading policy=outputs/arms/seed0/vt view=outputs/view_paper
    """

    policy: PolicyFolder = "outputs/arms/seed0/vt"  # checkpoint folder
    view: View = "outputs/view_paper"  # training view of demos with both fingers
    moments: Count = 12  # per episode and situation
    after: Count = 4  # [steps] of a chunk whose target is compared
    seed: Seed = 0  # of moments and of whose touch is exchanged
    out: OutFile = "outputs/policy_reading.json"  # result file


class Reader:
    """A checkpoint that is asked the same moments with other touch.

    Raises:
        CheckpointError: not a policy with one slot of latents.
    """

    def __init__(self, config: PolicyReadingConfig) -> None:
        settings = stored_config(Path(config.policy))
        if len(settings.slots) != 1 or settings.touch.input != "latent":
            came = f"touch_input={settings.touch.input} in {settings.slots}"
            raise CheckpointError(
                expected(config.policy, "one slot of latents", came, "Name a V+T checkpoint.")
            )
        self.slot, self.finger = settings.slots[0], settings.finger_by_slot()[settings.slots[0]]
        self._policy, self._before, _ = stored_policy(settings)
        self._moves = settings.action.previous_steps > 0  # then it is told where its command came from
        before = settings.action_delta_indices[:2] if self._moves else (0,)
        self._view = {finger: TrainingView(config.view, before, {self.slot: finger}) for finger in FINGERS}
        self._step = config.after - 1

    @torch.no_grad()
    def moves_mm(self, moments: np.ndarray, felt: np.ndarray, finger: Finger) -> np.ndarray:
        """Return (N, 2) height and width commanded at ``moments``, given what ``finger`` felt at ``felt``."""
        told = []
        for start in tqdm(range(0, len(moments), BATCH), desc=f"{finger} finger", leave=False):
            part = slice(start, start + BATCH)
            batch = default_collate(
                [self._sample(*pair, finger) for pair in zip(moments[part], felt[part], strict=True)]
            )
            chunk = self._policy.predict_action_chunk(self._before(batch))
            told.append(1000 * chunk[:, self._step, HEIGHT_AND_WIDTH].numpy())
        return np.concatenate(told)

    def _sample(self, moment: int, felt: int, finger: Finger) -> Sample:
        touch = latent_key(self.slot)
        sample = self._view[self.finger][int(moment)]
        sample[touch] = self._view[finger][int(felt)][touch]
        pictures = {camera_key(camera): sample[camera_key(camera)] / 255 for camera in CAMERAS}
        told = (STATE, touch, TASK, ACTION) if self._moves else (STATE, touch, TASK)
        return pictures | {key: sample[key] for key in told}


@dataclass(frozen=True)
class Demos:
    """What is asked of a view, frame by frame.

    Attributes:
        root: the view.
        episode: (F,) number of each frame's episode.
        wrench: finger → (F, 4) true wrench.
        worn: finger → (F,) kind of sensor.
        command_mm: (F, 2) commanded height and width.
    """

    root: Path
    episode: np.ndarray
    wrench: dict[Finger, np.ndarray]
    worn: dict[Finger, np.ndarray]
    command_mm: np.ndarray

    @classmethod
    def read(cls, root: Path) -> Demos:
        """Read a view.

        Raises:
            DatasetError: no view, or one without the true wrench.
        """
        marker = read_marker(root)
        if not marker["wrench"]:
            do = "Only simulated demos know it."
            raise DatasetError(expected(str(root), "the true wrench", "none", do))
        facts = marker["episodes"]
        episode = np.repeat(np.arange(len(facts)), [e["length"] for e in facts])
        return cls(
            root,
            episode,
            {f: read_array(root / f"{truth_wrench_key(f)}.npy") for f in FINGERS},
            {f: np.array([e[f"{f}_sensor"] for e in facts])[episode] for f in FINGERS},
            1000 * read_array(root / f"{ACTION}.npy")[:, HEIGHT_AND_WIDTH],
        )


@dataclass(frozen=True)
class Moments:
    """Frames of a view in one situation, evenly from its episodes.

    Attributes:
        frames: (N,) indices in the view.
        episode: (N,) whose.
        wrench: finger → (N, 4) true wrench.
        worn: finger → (N,) kind of sensor.
        demonstrated: how the demos' own commands answer ``learnt``'s force.
    """

    frames: np.ndarray
    episode: np.ndarray
    wrench: dict[Finger, np.ndarray]
    worn: dict[Finger, np.ndarray]
    demonstrated: Response


def find_moments(demos: Demos, learnt: Finger, name: str, config: PolicyReadingConfig) -> Moments:
    """Return moments in which the finger ``learnt`` is in the situation of that name.

    Raises:
        DatasetError: demos without such moments.
    """
    meant = SITUATIONS[name].meant(demos.wrench[learnt]) & _has_chunk(demos.episode, config.after)
    rng, picked = np.random.default_rng(config.seed), []
    for episode in np.unique(demos.episode):
        found = np.flatnonzero(meant & (demos.episode == episode))
        if len(found) >= config.moments:
            picked.append(rng.choice(found, config.moments, replace=False))
    if not picked:
        wanted = f"episodes with {config.moments} moments of {name}"
        raise DatasetError(expected(str(demos.root), wanted, "none", "Name another view, or ask for fewer."))
    frames = np.concatenate(picked)
    episode = demos.episode[frames]
    worn = {f: demos.worn[f][frames] for f in FINGERS}
    felt = {f: demos.wrench[f][frames] for f in FINGERS}
    moves_mm = demos.command_mm[frames + config.after - 1] - demos.command_mm[frames - 1]
    return Moments(frames, episode, felt, worn, response(Changes(moves_mm, felt[learnt], episode)))


def _has_chunk(episodes: np.ndarray, after: int) -> np.ndarray:
    """Return (N,) bool: the command before a frame and the last of its next ``after`` are of its episode."""
    frame = np.arange(len(episodes))
    return (episodes[np.maximum(frame - 1, 0)] == episodes[np.minimum(frame + after - 1, len(frame) - 1)]) & (
        (frame > 0) & (frame + after <= len(frame))
    )


def read_forces(
    reader: Reader, moments: Moments, forces: Sequence[str], seed: int
) -> tuple[Response, dict[str, dict[str, Misreading]]]:
    """Return how the policy answers its own finger, and sensor of the other finger → force → misreading."""
    learnt, other = reader.finger, next(finger for finger in FINGERS if finger != reader.finger)
    rng, frames = np.random.default_rng(seed), moments.frames
    own_mm = reader.moves_mm(frames, frames, learnt)

    def changes(chosen: np.ndarray, felt: np.ndarray, finger: Finger) -> Changes:
        moves = reader.moves_mm(frames[chosen], frames[felt], finger) - own_mm[chosen]
        wrench = moments.wrench[finger][felt] - moments.wrench[learnt][chosen]
        return Changes(moves, wrench, moments.episode[chosen])

    everywhere = np.arange(len(frames))
    answered, found = response(changes(everywhere, rng.permutation(everywhere), learnt)), {}
    for kind in np.unique(moments.worn[other]):
        chosen = np.flatnonzero(moments.worn[other] == kind)
        same, elsewhere = (changes(chosen, felt, other) for felt in (chosen, rng.permutation(chosen)))
        found[str(kind)] = misreading(same, elsewhere, answered, forces)
    return answered, found


def read_policy(config: PolicyReadingConfig) -> tuple[dict[str, Any], list[str]]:
    """Return the facts for the result file and the lines of the table."""
    reader, demos, facts = Reader(config), Demos.read(Path(config.view)), dict[str, Any]()
    lines = ["situation force  other finger   mean N  between episodes N  single moments N  slope ratio"]
    answers = ["situation force  mm per N: policy  demos"]
    for name, situation in SITUATIONS.items():
        moments = find_moments(demos, reader.finger, name, config)
        answered, found = read_forces(reader, moments, situation.forces, config.seed)
        per_N = {f: {"policy": answered.of(f), "demos": moments.demonstrated.of(f)} for f in situation.forces}
        answers += [f"{name:9s} {f:6s} {v['policy']:16.3f} {v['demos']:6.3f}" for f, v in per_N.items()]
        lines += [
            f"{name:9s} {force:6s} {kind:12s} {m.mean_N:+8.2f} {m.between_episodes_N:19.2f} {m.rms_N:17.2f} "
            f"{m.slope_ratio:12.2f}"
            for kind, forces in found.items()
            for force, m in forces.items()
        ]
        misread = {kind: {force: asdict(m) for force, m in forces.items()} for kind, forces in found.items()}
        facts[name] = {"moments": len(moments.frames), "mm_per_N": per_N, "misread": misread}
    return facts, [*lines, *answers]


@command(PolicyReadingConfig)
def main(config: PolicyReadingConfig) -> int:
    """Entry of ``python -m benchmarks.policy_reading``."""
    torch.set_num_threads(1)
    facts, lines = read_policy(config)
    written = write_json(Path(config.out), {"policy": config.policy, **facts} | provenance())
    print("\n".join([*lines, f"written to {written}"]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
