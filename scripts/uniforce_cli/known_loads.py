"""Presses of known load on one sensor: simulated, or by hand on a kitchen scale.

They give the gain of its latents.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, cast

import numpy as np

from uniforce_vtla.errors import ContractError, SensorError, expected
from uniforce_vtla.options import split

if TYPE_CHECKING:
    from uniforce_cli.paired_grasps import Encode
    from uniforce_robots.franka import UniforceFrankaConfig
    from uniforce_robots.sensors.config_uniforce import TactileFingerConfig
    from uniforce_robots.sensors.finger import TactileFinger
    from uniforce_vtla.contact.worn import WornSensor
    from uniforce_vtla.contracts import Finger
    from uniforce_vtla.tokenizer.latent import Latent

PER_LOAD = 3  # simulated presses of each load, each of another face at another place
TOOL_GRIP_N = 10.0  # of the hand that holds the tool, less or more by a fifth
TOOL_WEIGHT_N = 0.5
FRAMES = 10  # read of each press by hand, a third of a second
STANDARD_m_s2 = 9.80665  # newtons to what a scale shows

LOADS_N = (0.5, 50.0)  # lighter a scale shows badly, firmer breaks a gel

ON_HANDLE = (
    "Lay a tool's handle on a kitchen scale, set it to zero, "
    "and press the pad straight down on the handle."
)
WITH_TOOL = (
    "Let both fingers grasp the tool, hold it upright above a kitchen scale, "
    "and press it straight down on it."
)
Presses = tuple["Latent", np.ndarray]  # (n, P, L) pooled latents, and their loads (n,) in N


def known_loads(text: str) -> list[float]:
    """Return the loads of a list with commas; ContractError: none a finger bears."""
    found = [float(part) for part in split(text)]
    if not all(LOADS_N[0] <= load_N <= LOADS_N[1] for load_N in found):
        wanted = f"{LOADS_N[0]} to {LOADS_N[1]} N each"
        raise ContractError(expected("loads_N", wanted, text, "100 g on a scale are 1 N."))
    return found


def simulated_presses(
    worn: WornSensor, loads_N: Sequence[float], seed: int, encode: Encode
) -> Presses:
    """Press flat faces, as of a tool's handle, straight on the pad.

    Frames that the canonicalizer refuses are left out.

    Raises SensorError: it refuses all of them.
    """
    import torch

    from uniforce_cli.paired_grasps import seen
    from uniforce_vtla.contact.indenters import PRETRAIN
    from uniforce_vtla.contact.sampling import sample_objects
    from uniforce_vtla.contact.worn import WornView
    from uniforce_vtla.contracts import ContactState

    load_N = np.repeat(np.asarray(loads_N, np.float32), PER_LOAD)
    objects = sample_objects(
        np.random.default_rng([seed, 77]), len(load_N), PRETRAIN, flat_share=1.0
    )
    force = np.column_stack([0 * load_N, 0 * load_N, load_N])
    contact = ContactState(objects.gap_mm, force, 0 * load_N)
    found = seen(WornView(worn, seed), contact, "left", encode)
    if not found:
        do = "Use lighter loads."
        raise SensorError(
            expected("presses", "frames the canonicalizer reads", f"none of {len(load_N)}", do)
        )
    rows = sorted(found)
    latents = torch.stack([found[row] for row in rows])  # keeps the origin
    return latents, load_N[rows]  # type: ignore[return-value]


def simulated_tool(
    worn: WornSensor, loads_N: Sequence[float], seed: int, encode: Encode
) -> Presses:
    """Press a held tool on a scale.

    Each time grasped anew, then hanging free (0 N) and pressed by each load.

    Raises SensorError: the canonicalizer refuses every frame.
    """
    import torch

    from uniforce_cli.paired_grasps import seen
    from uniforce_vtla.contact.sampling import held_tools
    from uniforce_vtla.contact.worn import WornView
    from uniforce_vtla.contracts import ContactState

    rng = np.random.default_rng([seed, 78])
    load_N = np.tile(np.array([0.0, *loads_N], np.float32), PER_LOAD)
    grasp = np.repeat(np.arange(PER_LOAD), 1 + len(loads_N))
    gap_mm = held_tools(rng, PER_LOAD)[grasp]
    grip_N = (TOOL_GRIP_N * rng.uniform(0.8, 1.2, PER_LOAD))[grasp]
    # y is down: the tool's weight pulls down, the scale pushes up, and each finger bears half
    shear_N = (TOOL_WEIGHT_N - load_N) / 2
    force = np.column_stack([0 * load_N, shear_N, grip_N]).astype(np.float32)
    found = seen(WornView(worn, seed), ContactState(gap_mm, force, 0 * load_N), "left", encode)
    rows = sorted(found)
    if not any(load_N[row] == 0 for row in rows):
        do = "Is the tool's handle flat and as wide as the pad?"
        raise SensorError(
            expected(
                "presses", "frames the canonicalizer reads", f"{len(rows)} of {len(load_N)}", do
            )
        )
    latents = torch.stack([found[row] for row in rows])  # keeps the origin
    return latents, load_N[rows]  # type: ignore[return-value]


def finger_of(rig: str, finger: Finger) -> TactileFingerConfig:
    """Return a finger's settings from a rig's file, as ``uniforce record`` reads it.

    Raises ContractError: it has none.
    """
    from uniforce_robots.recorder.build import read_devices

    robot = cast("UniforceFrankaConfig", read_devices([], True, "keyboard", rig)[0])
    if found := [worn for worn in robot.fingers.values() if worn.finger == finger]:
        return found[0]
    do = "Name it among robot.cameras, see docs/recording.md."
    raise ContractError(
        expected(f"{finger} finger of {rig}", "a tactile sensor", list(robot.cameras), do)
    )


def presses_by_hand(
    finger: TactileFinger,
    loads_N: Sequence[float],
    encode: Encode,
    through_tool: bool = False,
    ask: Callable[[str], object] = input,
) -> Presses:
    """Ask for each load on a scale, and read some frames of it when Enter says that it is held.

    Raises ContractError: nobody is at a terminal; SensorError: the sensor is lost.
    """
    import torch

    if ask is input and not sys.stdin.isatty():
        do = "Run it where somebody can press Enter."
        raise ContractError(expected("presses by hand", "a terminal", "another input", do))
    reference = finger.reference_image()[..., 0]
    side = cast("Finger", finger.config.finger)
    latents = []
    if through_tool:
        loads_N = [0.0, *loads_N]
    print(WITH_TOOL if through_tool else ON_HANDLE)
    for load_N in loads_N:
        wish = "let the tool hang free of the scale"
        if load_N:
            grams = 1000 * load_N / STANDARD_m_s2
            wish = f"until the scale shows {grams:.0f} g ({load_N:g} N); hold it"
        ask(f"{wish} and press Enter ")
        images = []
        index = -1
        for _ in range(FRAMES):
            touch = finger.next_touch(index)
            index = touch.index
            images.append(finger.marker_image(touch.raw))
        latents.append(encode(reference, np.stack(images), side))  # (FRAMES, P, L)
    held_N = np.repeat(np.asarray(loads_N, np.float32), FRAMES)
    return torch.cat(latents), held_N  # type: ignore[return-value]  # cat keeps the origin
