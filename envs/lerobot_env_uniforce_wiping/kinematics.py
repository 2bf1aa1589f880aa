"""Damped least squares: joint angles that put the tool at a pose. Used at reset only."""

from __future__ import annotations

import mujoco
import numpy as np

HOME_q = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
DAMPING = 0.05
STEP_LIMIT = 0.3  # largest joint change per iteration, rad


def pose_error(data: mujoco.MjData, site: int, position_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return (6,) position and rotation-vector error of a site towards a pose, world frame."""
    turn = rotation @ data.site_xmat[site].reshape(3, 3).T
    vee = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return np.concatenate([position_m - data.site_xpos[site], vee / 2])


def solve_arm(
    model: mujoco.MjModel, data: mujoco.MjData, position_m: np.ndarray, rotation: np.ndarray
) -> float:
    """Set the arm's seven joints so that site ``tcp`` meets the pose; return the remaining error norm."""
    site = model.site("tcp").id
    data.qpos[model.jnt_qposadr[model.joint("joint1").id] :][:7] = HOME_q
    first = model.jnt_dofadr[model.joint("joint1").id]
    jacobian = np.zeros((6, model.nv))
    for _ in range(60):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        error = pose_error(data, site, position_m, rotation)
        if np.linalg.norm(error) < 1e-6:
            break
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
        J = jacobian[:, first : first + 7]
        step = J.T @ np.linalg.solve(J @ J.T + DAMPING**2 * 1e-2 * np.eye(6), error)
        data.qpos[model.jnt_qposadr[model.joint("joint1").id] :][:7] += np.clip(step, -STEP_LIMIT, STEP_LIMIT)
    return float(np.linalg.norm(error))
