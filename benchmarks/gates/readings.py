"""The expert with another reading of grip and press: changed, or worked out without touch."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lerobot_env_uniforce_wiping.env import WipeEnv
from lerobot_env_uniforce_wiping.expert import Contact, WipeExpert
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from uniforce_vtla.contracts import Finger

# what is read, the scene and the phase → what is believed
Change = Callable[[Contact, WipeEnv, str], Contact]
FEELS_s = 0.5  # of wiping, before touch freezes


class ReadingExpert(WipeExpert):
    """The expert, who believes what a rule makes of a reading; each episode has a new rule."""

    def __init__(self, change: Callable[[], Change]) -> None:
        super().__init__()
        self._make_change = change

    def reset(self, env: WipeEnv) -> None:
        self._change, self._env = self._make_change(), env
        super().reset(env)

    def _estimate(self, wrench: dict[Finger, np.ndarray]) -> Contact:
        return self._change(super()._estimate(wrench), self._env, self.phase)


def scaled(factor: float) -> Change:
    """Read so many times what is there."""
    return lambda read, env, phase: Contact(factor * read.grip_N, factor * read.press_N)


def shifted(by_N: float) -> Change:
    """Read so many newtons more than is there, of press and of grip, once the eraser is held."""
    return lambda read, env, phase: (
        read if phase in ("descend", "close") else Contact(read.grip_N + by_N, read.press_N + by_N)
    )


class EverySixth:
    """Touch refreshed every sixth step: what a policy reads that executes six steps of a chunk."""

    def __init__(self, steps: int = 6) -> None:
        self._steps, self._count = steps, 0
        self._read = Contact(0.0, 0.0)

    def __call__(self, read: Contact, env: WipeEnv, phase: str) -> Contact:
        if self._count % self._steps == 0:
            self._read = read
        self._count += 1
        return self._read


class Frozen:
    """Touch that freezes half a second into the wipe."""

    def __init__(self) -> None:
        self._wiped, self._read = 0, Contact(0.0, 0.0)

    def __call__(self, read: Contact, env: WipeEnv, phase: str) -> Contact:
        self._wiped += phase == "wipe"
        if self._wiped <= FEELS_s * CONTROL_HZ:
            self._read = read
        return self._read


class PlaneKnown:
    """Press from the measured height, by one who knows the board's mean plane; grip is read.

    ``stiffness_N_m`` and ``rest_m`` are fitted on development scenes: newtons per metre by which
    the hand is lower than where the eraser just touches the plane.
    """

    def __init__(self, stiffness_N_m: float, rest_m: float) -> None:
        self._stiffness_N_m, self._rest_m = stiffness_N_m, rest_m
        self._grasp_m = np.nan

    def __call__(self, read: Contact, env: WipeEnv, phase: str) -> Contact:
        # the eraser stands on the table: how high on it the hand holds it
        if phase in ("descend", "close"):
            self._grasp_m = env.state[2]
            return read
        return replace(
            read, press_N=self._stiffness_N_m * (self._rest_m + sunk_m(env, self._grasp_m))
        )


def sunk_m(env: WipeEnv, grasp_m: float) -> float:
    """Return by how much the hand is below where the eraser is on the board's mean plane."""
    scene, x, y, z = env.scene, *env.state[:3].astype(np.float64)
    centre = np.add(env.level.layout.board_center_m, scene.board_shift_m)
    tilt_x, tilt_y = scene.board_tilt_rad
    plane_m = (
        scene.board_height_m + (y - centre[1]) * np.tan(tilt_x) - (x - centre[0]) * np.tan(tilt_y)
    )
    return float(plane_m + grasp_m - z)
