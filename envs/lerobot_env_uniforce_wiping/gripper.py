"""Grippers of the scene: an ideal servo, or a hand with the rules of the robot's.

The servo follows widths by tenths of a millimetre; no real gripper does. The Franka Hand takes a
grasp with a force, holds by itself, and reports its width ten times a second.
``uniforce_vtla.hand.Hand`` decides its commands, here as on the robot.
"""

from typing import Protocol

import mujoco
import numpy as np

from lerobot_env_uniforce_wiping.mjcf import GRIPPER_FORCE_N
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.hand import Hand, HandCommand, HandReading, HandRules, OUTER_m

GRIPPERS = ("servo", "hand")
ACTUATOR = 6  # of the width, after the arm's six
MAX_WIDTH_m = 0.08
STATE_PERIOD_s = 0.1  # of the hand's readings
# a grasp's force is off by up to this share, once per episode: the real one is specified no better
FORCE_ERROR = 0.2
STILL_m = 0.0002  # fingers that go less than this within ``STILL_s`` have arrived
STILL_s = 0.1
ARRIVED_m = 0.001  # of a plain move's goal


class Gripper(Protocol):
    """Moves the fingers of one scene."""

    @property
    def width_m(self) -> float:
        """The opening as the robot's state gives it."""

    @property
    def holds(self) -> bool | None:
        """Whether it holds something, by its own word; None where it doesn't know."""

    def command(self, width_m: float) -> None:
        """Wish a width from now on; raises RobotError where the hand is at fault."""

    def advance(self, dt_s: float) -> None:
        """Set the actuator for the next ``dt_s`` of physics."""


class Servo:
    """The fingers follow each width that differs by more than the dead band."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, width_m: float, dead_band_m: float
    ) -> None:
        self._data = data
        self._addresses = finger_addresses(model)
        self._dead_band_m = dead_band_m
        self._applied_m = width_m

    @property
    def width_m(self) -> float:
        """The opening now."""
        return finger_width(self._data, self._addresses)

    @property
    def holds(self) -> bool | None:
        """None: a servo feels nothing."""
        return None

    def command(self, width_m: float) -> None:
        """Go to a width at once."""
        if abs(width_m - self._applied_m) > self._dead_band_m:
            self._applied_m = width_m
        self._data.ctrl[ACTUATOR] = self._applied_m

    def advance(self, dt_s: float) -> None:
        """Do nothing: the actuator has its width."""


class FrankaHand:
    """The fingers follow ``Hand``: grasps of bounded force and moves, one at a time."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, seed: int) -> None:
        self._client = SceneHand(model, data, force_share(seed))
        self.hand = Hand(self._client, HandRules(), lambda: float(data.time))
        self.hand.start()

    @property
    def width_m(self) -> float:
        """The opening by the hand's newest reading."""
        return self.hand.reading.width_m

    @property
    def holds(self) -> bool | None:
        """Whether it holds something, by the hand's newest reading."""
        return self.hand.reading.is_grasped

    def command(self, width_m: float) -> None:
        """Wish a width; raises RobotError, e.g. ``grasp_lost``."""
        self.hand.submit(width_m)
        self.hand.tick()

    def advance(self, dt_s: float) -> None:
        """Move the fingers as the command under way asks."""
        self._client.advance(dt_s)


class SceneHand:
    """A ``HandClient`` over the scene's fingers: a moving set point and a force limit.

    Args:
        model: the scene's; each command changes the force limit of the width's actuator.
        data: the scene's.
        force_share: true force of a grasp over the commanded one.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, force_share: float) -> None:
        self._model = model
        self._data = data
        self._force_share = force_share
        self._addresses = finger_addresses(model)
        self._set_point_m = finger_width(data, self._addresses)
        self._command: HandCommand | None = None  # in flight
        self._holding: HandCommand | None = None  # the grasp that succeeded last
        self._outcome: bool | None = None
        self._looked_m = self._set_point_m
        self._looked_s = 0.0
        self._reading = self._read_now()

    def connect(self) -> None:
        """Do nothing: the scene's hand is there."""

    def refuse_closed(self) -> None:
        """Do nothing: nobody can pull its plug."""

    def read(self) -> HandReading:
        """Return the newest reading, up to a tenth of a second old."""
        return self._reading

    def begin(self, command: HandCommand) -> None:
        """Start a command from where the fingers are."""
        self._command = command
        self._holding = self._outcome = None
        self._looked_m = self._set_point_m = finger_width(self._data, self._addresses)
        self._looked_s = float(self._data.time)
        limit_N = command.force_N * self._force_share if command.force_N > 0 else GRIPPER_FORCE_N
        self._model.actuator_forcerange[ACTUATOR] = (-limit_N, limit_N)

    def poll(self) -> bool | None:
        """Return how the command in flight ended, once; None while it runs."""
        outcome = self._outcome
        self._outcome = None
        return outcome

    def stop(self) -> None:
        """Stop the fingers where they are."""
        if self._command is not None:
            self._outcome = False
        self._command = self._holding = None
        self._set_point_m = finger_width(self._data, self._addresses)

    def advance(self, dt_s: float) -> None:
        """Move the set point, end a finished command, and read the state when it is due."""
        command = self._command
        if command is not None:
            end_m = 0.0 if command.force_N > 0 else command.width_m
            step_m = command.speed_m_s * dt_s
            self._set_point_m += float(np.clip(end_m - self._set_point_m, -step_m, step_m))
            self._end_if_still(command)
        self._data.ctrl[ACTUATOR] = self._set_point_m
        if self._data.time - self._reading.time_s >= STATE_PERIOD_s:
            self._reading = self._read_now()

    def _end_if_still(self, command: HandCommand) -> None:
        if self._data.time - self._looked_s < STILL_s:
            return
        width_m = finger_width(self._data, self._addresses)
        went_m = abs(width_m - self._looked_m)
        self._looked_m = width_m
        self._looked_s = float(self._data.time)
        if went_m > STILL_m:
            return
        self._command = None
        if command.force_N > 0:
            self._set_point_m = 0.0  # the motor keeps its force
            self._outcome = is_within(command, width_m)
            self._holding = command if self._outcome else None
        else:
            self._outcome = abs(width_m - command.width_m) < ARRIVED_m

    def _read_now(self) -> HandReading:
        width_m = finger_width(self._data, self._addresses)
        is_grasped = self._holding is not None and is_within(self._holding, width_m)
        return HandReading(float(self._data.time), width_m, MAX_WIDTH_m, is_grasped)


def is_within(grasp: HandCommand, width_m: float) -> bool:
    """Return whether fingers so far apart hold something, by the tolerances of a grasp."""
    return grasp.grasp_width_m - grasp.inner_m < width_m < grasp.grasp_width_m + OUTER_m


def finger_addresses(model: mujoco.MjModel) -> list[int]:
    """Return where the positions of both fingers stand in ``qpos``."""
    return [model.jnt_qposadr[model.joint(f"finger_{finger}").id] for finger in FINGERS]


def finger_width(data: mujoco.MjData, addresses: list[int]) -> float:
    """Return the opening between the fingers, m."""
    return float(sum(data.qpos[addresses]))


def force_share(seed: int) -> float:
    """Draw the true force of an episode's grasps over the commanded one."""
    return float(np.random.default_rng([seed, 70_457]).uniform(1 - FORCE_ERROR, 1 + FORCE_ERROR))


def require_gripper(name: str) -> None:
    """Raise ContractError where no gripper has this name."""
    if name not in GRIPPERS:
        raise ContractError(expected("gripper", " | ".join(GRIPPERS), repr(name), "Name one."))
