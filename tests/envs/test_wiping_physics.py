from __future__ import annotations

import itertools
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from lerobot_env_uniforce_wiping import draw_scene
from lerobot_env_uniforce_wiping.ink import InkField
from lerobot_env_uniforce_wiping.simulation import DOME_N_mm, FLAT_N_mm, WipeSimulation
from uniforce_vtla.contracts import FINGERS

SEED = 3


def quiet_scene(**changes: object):
    """A scene with nothing hidden in the way of a measurement."""
    calm = {
        "stiffness_scale": 1.0,
        "stiction_Nm": 0.0,
        "gripper_gain": 1.0,
        "gripper_dead_band_m": 0.0,
        "board_tilt_rad": (0.0, 0.0),
        "gel_scale": (1.0, 1.0),
        "pad_friction": (0.8, 0.8),
        "eraser_offset_m": (0.0, 0.0),
        "start_offset_m": (0.0, 0.0, 0.0),
    }
    return replace(draw_scene(SEED, "easy"), **(calm | changes))


def hold(sim: WipeSimulation, target: list[float], steps: int) -> None:
    for _ in range(steps):
        sim.command(np.array(target))
        sim.step()


def grasped(width_m: float = 0.022, **changes: object) -> WipeSimulation:
    sim = WipeSimulation(quiet_scene(**changes), "gelsight", "tactip")
    x, y = sim.scene.level.layout.tray_m
    hold(sim, [x, y, 0.03, 0.0, 0.05], 25)
    hold(sim, [x, y, 0.03, 0.0, width_m], 35)
    hold(sim, [x, y, 0.075, 0.0, width_m], 40)
    return sim


def pressed(depth_m: float) -> WipeSimulation:
    sim = grasped()
    scene = sim.scene
    x, y = scene.level.layout.board_center_m
    hold(sim, [x, y - 0.05, 0.075, 0.0, 0.022], 60)
    hold(sim, [x, y - 0.05, scene.board_height_m + 0.03 - depth_m, 0.0, 0.022], 45)
    return sim


@pytest.mark.parametrize("mass_kg", [0.04, 0.12])
def test_gel_indentation_is_force_over_stiffness(mass_kg: float) -> None:
    sim = grasped(eraser_mass_kg=mass_kg)
    for finger, stiffness in zip(FINGERS, (FLAT_N_mm, DOME_N_mm), strict=True):
        pad = sim.pads[finger]
        assert pad.wrench[2] > 3
        assert pad.depth_mm == pytest.approx(pad.wrench[2] / stiffness, rel=0.05)


def test_slip_load_is_near_two_mu_grip() -> None:
    sim = grasped(pad_friction=(0.6, 0.6))
    grip = np.mean([sim.pads[f].wrench[2] for f in FINGERS])
    limit = 2 * 0.6 * float(grip)
    start = sim.eraser_in_tool()[2]

    def slid_under(load_N: float) -> float:
        sim.data.xfrc_applied[sim.model.body("eraser").id, 2] = -load_N
        hold(sim, list(sim.target), 20)
        return float((sim.eraser_in_tool()[2] - start) * 1000)

    weight = sim.scene.eraser_mass_kg * 9.81
    assert slid_under(0.85 * limit - weight) < 1.5  # the gel's own shear
    assert slid_under(1.20 * limit - weight) > 10


def test_a_held_eraser_does_not_creep() -> None:
    sim = grasped()
    start = sim.eraser_in_tool()
    hold(sim, list(sim.target), 60)
    assert np.linalg.norm(sim.eraser_in_tool() - start) < 2e-4


def test_pressing_on_the_board_pushes_both_pads_up_and_right_amount() -> None:
    sim = pressed(0.008)
    weight = sim.scene.eraser_mass_kg * 9.81
    up = {f: sim.pads[f].wrench[1] for f in FINGERS}
    assert sim.press_N > 3
    assert up["left"] < 0 and up["right"] < 0  # the contract: canonical fy < 0 on both
    assert -(up["left"] + up["right"]) == pytest.approx(sim.press_N - weight, abs=0.5)


def test_dragging_along_y_shears_both_pads_backwards() -> None:
    sim = pressed(0.008)
    x, y, z, yaw, width = sim.target
    hold(sim, [x, y + 0.05, z, yaw, width], 12)
    assert all(sim.pads[f].wrench[0] < -0.2 for f in FINGERS)  # canonical fx against the motion, same sign


def test_normal_forces_agree() -> None:
    sim = pressed(0.006)
    left, right = (sim.pads[f].wrench[2] for f in FINGERS)
    assert left == pytest.approx(right, rel=0.08)


def test_residual_falls_with_press() -> None:
    def residual(press_N: float) -> float:
        ink = InkField(draw_scene(SEED, "easy"))
        for y in np.linspace(-0.05, 0.05, 60):
            for x in (-0.01, 0.01):
                ink.wipe(np.array([x, y]), 0.0, np.array([0.03, 0.06]), np.array([press_N, 0, 0]), 0.1 / 60)
        return ink.residual

    values = [residual(p) for p in (0.0, 2.0, 4.0, 6.0, 8.0)]
    assert values[0] == 1.0 and all(a >= b for a, b in itertools.pairwise(values))
    assert values[1] > 0.3 > 0.1 > values[-1]


def test_leash_bounds_the_force_of_any_command() -> None:
    sim = pressed(0.0)
    x, y = sim.measured[:2]
    hold(sim, [x, y, -1.0, 0.0, 0.022], 60)
    assert sim.press_N < 800 * 0.018 * 1.15


def test_same_scene_same_trajectory() -> None:
    first, second = grasped(), grasped()
    assert np.array_equal(first.data.qpos, second.data.qpos)
    assert first.data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number == 0
