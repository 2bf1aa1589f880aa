"""Collect the truth of an episode step by step; the trace is what scores are computed from."""

import numpy as np

from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from lerobot_env_uniforce_wiping.simulation import WipeSimulation
from uniforce_vtla.evaluation.episode import STEP_FIELDS, EpisodeTrace
from uniforce_vtla.sensors import get_sensor

LIFT_TOOL_m = 0.045  # tool height above the table at which a grasped eraser counts as lifted
HELD_m = 0.030  # eraser's distance from its place between the pads while it counts as held
CLEAR_m = 0.020  # tool height over its wiping height that ends a wipe
WIPING_PRESS_N = 0.5  # first press above this starts the wiping phase


class TraceRecorder:
    """Keep one row per step and the phase: 0 before lift, 1 carrying, 2 wiping, 3 lifted off."""

    def __init__(self, simulation: WipeSimulation) -> None:
        self._sim = simulation
        self._rows: np.ndarray = np.zeros((256, len(STEP_FIELDS)))  # grows by doubling
        self._count = 0
        self._at_lift: np.ndarray | None = None
        self.phase = 0

    def record(self) -> None:
        """Append the state after a step."""
        sim = self._sim
        height_m = self._sim.measured[2]
        self._update_phase(height_m)
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        left = sim.pads["left"]
        right = sim.pads["right"]
        self._rows[self._count] = (
            (self._count + 1) / CONTROL_HZ,
            sim.press_N,
            left.wrench[2],
            right.wrench[2],
            self.slip_mm(),
            left.depth_mm,
            right.depth_mm,
            height_m * 1000,
            sim.slide_m * 1000,
            sim.ink.residual,
            self.phase,
        )  # in the order of STEP_FIELDS
        self._count += 1

    def _update_phase(self, height_m: float) -> None:
        sim = self._sim
        layout = self._sim.scene.level.layout
        if self.phase == 0 and height_m > LIFT_TOOL_m and self._held():
            self.phase = 1
            self._at_lift = sim.eraser_in_tool()
        elif self.phase in (1, 3) and sim.press_N > WIPING_PRESS_N:
            self.phase = 2
        elif (
            self.phase == 2
            and height_m > sim.scene.board_height_m + layout.grasp_height_m + CLEAR_m
        ):
            self.phase = 3

    def _held(self) -> bool:
        sim = self._sim
        nominal = np.array([0.0, 0.0, sim.scene.level.layout.grasp_height_m])
        near = float(np.linalg.norm(sim.eraser_in_tool() - nominal)) < HELD_m
        return near and sim.pads["left"].wrench[2] > 0 and sim.pads["right"].wrench[2] > 0

    def slip_mm(self) -> float:
        """In-hand displacement across the pads (tool y, z) since the lift."""
        if self._at_lift is None:
            return 0.0
        return float(np.linalg.norm((self._sim.eraser_in_tool() - self._at_lift)[1:])) * 1000

    def trace(self) -> EpisodeTrace:
        """Return what was recorded so far."""
        columns = {name: self._rows[: self._count, i].copy() for i, name in enumerate(STEP_FIELDS)}
        left = get_sensor(self._sim.sensors["left"])
        right = get_sensor(self._sim.sensors["right"])
        rated_depth_mm = (left.rated_depth_mm, right.rated_depth_mm)
        return EpisodeTrace(**columns, rated_depth_mm=rated_depth_mm)
