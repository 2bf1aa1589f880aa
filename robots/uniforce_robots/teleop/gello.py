"""Steer with a GELLO: its joints, through the Franka's published kinematics, are a pose. Never run on hardware."""

from __future__ import annotations

import numpy as np

from uniforce_robots.fr3 import HAND_TO_FLANGE, JOINTS, posture
from uniforce_robots.franka.poses import ToolPose
from uniforce_robots.sensors.reader import ReaderLimits, SampleReader
from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.configs import UniforceGelloConfig
from uniforce_robots.teleop.gello_bus import GelloBus
from uniforce_vtla.errors import ContractError, SensorError, TeleoperatorError, expected

FIRST_READING_MS = 2000.0
STALE_MS = 150.0  # an older reading is not followed
JUMP_rad = 0.35  # a joint that turns further between two readings has slipped or lies
# A GELLO that lies still repeats itself: that is no fault.
LIMITS = ReaderLimits(capacity=64, frozen_after=0, silent_s=1.0)


def tool_axes(q_rad: np.ndarray, flange_to_tool_m: float) -> np.ndarray:
    """Return (4,) x, y, z m and yaw rad of the tool at joint angles (7,); a tilt is dropped: no policy knows of it."""
    hand = HAND_TO_FLANGE.copy()
    hand[2, 3] = flange_to_tool_m
    pose = ToolPose.from_ee(posture(q_rad).flange_to_base @ hand)
    return np.array([*pose.position_m, pose.yaw_rad])


def offsets(motor_rad: np.ndarray, signs: np.ndarray, held_rad: np.ndarray) -> np.ndarray:
    """Return the (7,) offsets of a GELLO that is held in a known posture, each a multiple of a quarter turn.

    Motors are mounted at quarter turns, so that rounding takes out how inexactly a hand holds the posture.
    """
    return np.round((motor_rad - signs * held_rad) / (np.pi / 2)) * (np.pi / 2)


class UniforceGello(UniforceTeleoperator):
    """The target follows the GELLO's pose at limited speed; the trigger is the width."""

    config_class = UniforceGelloConfig
    name = "uniforce_gello"

    def __init__(self, config: UniforceGelloConfig) -> None:
        super().__init__(config, config.limits)
        if not (len(config.signs) == len(config.offsets_rad) == JOINTS and len(config.ids) == JOINTS + 1):
            came = f"{len(config.ids)} ids, {len(config.signs)} signs, {len(config.offsets_rad)} offsets"
            do = "Seven joints and the trigger; signs and offsets of the joints."
            raise ContractError(expected("gello", f"{JOINTS + 1}, {JOINTS}, {JOINTS}", came, do))
        self.reader = SampleReader(GelloBus(config.port, config.ids, config.baud), LIMITS)
        self._last: np.ndarray | None = None

    @property
    def is_connected(self) -> bool:
        """Whether its motors are asked."""
        return self.reader.is_running

    def _open(self) -> None:
        self.reader.start()
        try:
            self.reader.wait_newer(-1, FIRST_READING_MS)
        except SensorError:
            self.reader.stop()
            raise

    def _close(self) -> None:
        self.reader.stop()

    def _begin(self, measured: np.ndarray) -> None:
        self._last = None
        self.config.start.check(measured, self._pose(), self.name)

    def _next(self, elapsed_s: float) -> np.ndarray:
        return self.integrator.towards(self._pose(), elapsed_s, self.measured)

    def _pose(self) -> np.ndarray:
        """(5,) where the GELLO is, as the robot's axes."""
        q, trigger = self._joints_and_trigger()
        self._check_jump(q)
        share = np.interp(trigger, *_rising(self.config.trigger_rad, (0.0, 1.0)))
        open_m, closed_m = self.config.width_m
        width = open_m + share * (closed_m - open_m)
        return np.array([*tool_axes(q, self.config.flange_to_tool_m), width])

    def _joints_and_trigger(self) -> tuple[np.ndarray, float]:
        motors = self.reader.newest(STALE_MS).data
        q: np.ndarray = np.array(self.config.signs) * (motors[:JOINTS] - np.array(self.config.offsets_rad))
        return q, float(motors[JOINTS])

    def _check_jump(self, q: np.ndarray) -> None:
        turn_rad = np.abs(q - (q if self._last is None else self._last))
        self._last = q
        if turn_rad.max() > JUMP_rad:
            what = f"{self.name}, joint {int(turn_rad.argmax()) + 1}"
            wanted = f"less than {JUMP_rad} rad between two readings"
            do = "Check horn and cable of the joint, then start again."
            raise TeleoperatorError(expected(what, wanted, f"{turn_rad.max():.2f}", do), "garbage")


def _rising(
    x: tuple[float, float], y: tuple[float, float]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return points in the order ``np.interp`` needs."""
    return (x, y) if x[0] < x[1] else (x[::-1], y[::-1])
