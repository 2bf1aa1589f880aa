"""A rig in the scene to measure what a laboratory would: stiffness, slip, creep, wear, the step."""

import time
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from lerobot_env_uniforce_wiping.ink import InkField
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from lerobot_env_uniforce_wiping.mjcf import SolverSettings
from lerobot_env_uniforce_wiping.scene_params import SceneParams, draw_scene
from lerobot_env_uniforce_wiping.simulation import WipeSimulation
from uniforce_vtla.contracts import FINGERS

GRAVITY_m_s2 = 9.81
OPEN_m = 0.050  # gripper before the grasp
CARRY_m = 0.075  # tool height out of reach of the board
GRASP_m = 0.030  # tool height over the eraser's felt
SLIDING_mm = 3.0  # in-hand motion that is no longer the gel's own shear
STROKE_m, STROKE_m_s = 0.11, 0.078  # length and pace of a stroke
STARTING_STEPS = 10  # control steps until the stroke runs evenly
LOAD_STEP_N = 0.02  # added per control step while a load ramps up: 0.6 N/s, slow against the gel


def quiet_scene(seed: int = 3, level: str = "easy", **changes: Any) -> SceneParams:
    """Return a scene with nothing hidden in the way; ``changes`` are fields of SceneParams."""
    calm: dict[str, Any] = dict.fromkeys(("stiffness_scale", "gripper_gain", "letter_scale"), 1.0)
    calm |= dict.fromkeys(
        ("stiction_Nm", "gripper_dead_band_m", "board_turn_rad", "eraser_turn_rad"), 0.0
    )
    calm |= dict.fromkeys(("board_tilt_rad", "eraser_offset_m", "board_shift_m"), (0.0, 0.0))
    calm |= {"pad_friction": (0.8, 0.8), "start_offset_m": (0.0, 0.0, 0.0)}
    return replace(draw_scene(seed, level), **(calm | changes))


def hold(sim: WipeSimulation, target: list[float] | np.ndarray, steps: int) -> None:
    """Command one absolute target (5,) for so many control steps."""
    for _ in range(steps):
        sim.command(np.asarray(target, dtype=float))
        sim.step()


def grasped(
    width_m: float = 0.022,
    solver: SolverSettings | None = None,
    stiffness: tuple[float, float] = (1.0, 1.0),
    **changes: Any,
) -> WipeSimulation:
    """Return a simulation that holds the eraser in the air, commanded to ``width_m``."""
    # the servo follows a width at once: physics is asked about pads and tool, not about the hand
    sim = WipeSimulation(
        quiet_scene(**changes), "gelsight", "tactip", solver, stiffness, gripper="servo"
    )
    x, y = sim.scene.level.layout.tray_m
    hold(sim, [x, y, GRASP_m, 0.0, OPEN_m], 25)
    hold(sim, [x, y, GRASP_m, 0.0, width_m], 35)
    hold(sim, [x, y, CARRY_m, 0.0, width_m], 40)
    return sim


def pressed(depth_m: float, solver: SolverSettings | None = None, **changes: Any) -> WipeSimulation:
    """Return one that presses the eraser on the board, ``depth_m`` below first contact."""
    sim = grasped(solver=solver, **changes)
    x, y = sim.scene.level.layout.board_center_m
    width = sim.target[4]
    hold(sim, [x, y - 0.05, CARRY_m, 0.0, width], 60)
    hold(sim, [x, y - 0.05, sim.scene.board_height_m + GRASP_m - depth_m, 0.0, width], 45)
    return sim


def squeeze(width_m: float, **changes: Any) -> np.ndarray:
    """Return settled force N and indentation mm, (2, 2), of (left, right), at a commanded width."""
    sim = grasped(width_m, **changes)
    pads = [sim.pads[finger] for finger in FINGERS]
    return np.array([[pad.wrench[2] for pad in pads], [pad.depth_mm for pad in pads]])


def slip_load(friction: float, width_m: float = 0.022) -> dict[str, float]:
    """Load the held eraser until it slides; return what Coulomb allows, 2 μ F, and what it took."""
    sim = grasped(width_m, pad_friction=(friction, friction))
    eraser = sim.model.body("eraser").id
    weight_N = sim.scene.eraser_mass_kg * GRAVITY_m_s2
    coulomb = 2 * friction * _grip_N(sim)
    load = 0.5 * coulomb - weight_N  # ramp from half of it
    start = sim.eraser_in_tool()[2]
    while (sim.eraser_in_tool()[2] - start) * 1000 < SLIDING_mm and load < 2 * coulomb:
        load += LOAD_STEP_N
        sim.data.xfrc_applied[eraser, 2] = -load
        hold(sim, sim.target, 1)
    return {"coulomb_N": coulomb, "measured_N": load + weight_N}


def creep_mm_s(
    share: float, friction: float = 0.6, seconds: float = 2.0, solver: SolverSettings | None = None
) -> float:
    """Return how fast the held eraser sinks under a share of its slip load, once settled."""
    sim = grasped(solver=solver, pad_friction=(friction, friction))
    load = share * 2 * friction * _grip_N(sim) - sim.scene.eraser_mass_kg * GRAVITY_m_s2
    sim.data.xfrc_applied[sim.model.body("eraser").id, 2] = -load
    hold(sim, sim.target, 30)  # the gel's own shear comes to rest
    start = sim.eraser_in_tool()[2]
    hold(sim, sim.target, round(seconds * CONTROL_HZ))
    return float(sim.eraser_in_tool()[2] - start) * 1000 / seconds


def _grip_N(sim: WipeSimulation) -> float:  # noqa: N802  a unit
    return float(np.mean([sim.pads[finger].wrench[2] for finger in FINGERS]))


@dataclass(frozen=True)
class Stroke:
    """One stroke: mean press N, the ink it left (share), simulated seconds per CPU second."""

    press_N: float
    residual: float
    times_real_time: float


def stroke(depth_m: float, solver: SolverSettings | None = None, **changes: Any) -> Stroke:
    """Press and draw the eraser once along the word at the expert's pace."""
    sim = pressed(depth_m, solver, **changes)
    target, presses = sim.target.copy(), []
    steps = round(STROKE_m / STROKE_m_s * CONTROL_HZ)
    begin = time.process_time()
    for _ in range(steps):
        target[1] += STROKE_m_s / CONTROL_HZ
        hold(sim, target, 1)
        presses.append(sim.press_N)
    took = time.process_time() - begin
    settled = presses[STARTING_STEPS:]
    return Stroke(float(np.mean(settled)), sim.ink.residual, steps / CONTROL_HZ / took)


def residual_after(press_N: float, passes: int = 2, seed: int = 3, level: str = "easy") -> float:
    """Return the share of ink left by an even ``press_N``, drawn ``passes`` times over the word."""
    scene = draw_scene(seed, level)
    ink = InkField(scene)
    layout = scene.level.layout
    size = np.array([layout.eraser_width_m, layout.eraser_length_m])
    load = np.array([press_N, 0.0, 0.0])
    ys = np.linspace(-scene.level.word_length_m / 2, scene.level.word_length_m / 2, 80)
    rows = np.linspace(-0.5, 0.5, passes) * (scene.level.letter_height_m - 0.010)
    for x in rows:
        for y in ys:
            ink.wipe(np.array([x, y]), 0.0, size, load, float(ys[1] - ys[0]))
    return ink.residual


def warnings(sim: WipeSimulation) -> int:
    """Return how often MuJoCo found a state it had to reset."""
    kinds = (mujoco.mjtWarning.mjWARN_BADQACC, mujoco.mjtWarning.mjWARN_BADQPOS)
    return int(sum(sim.data.warning[k].number for k in kinds))
