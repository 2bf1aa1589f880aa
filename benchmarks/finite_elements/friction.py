"""Frictional contact of a rigid object on a pad's finite elements, in steps of the object's path.

The normal part by an active set (p ≥ 0, no cell sinks in), the tangential part by projected
gradients with momentum (FISTA) on what changed since the last step, |q| ≤ μ·p cell by cell; both in
turns, for they couple: a nearly incompressible gel bulges under pressure, and friction holds it.
The simulator's fast model knows neither.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

_TURNS, _ACTIVE_ROUNDS, _GRADIENT_STEPS = 30, 60, 400
_CLOSE = 1e-4  # of the largest pressure: turns end
_STILL = 1e-5  # of the largest force a cell may carry, per gradient step


@dataclass(frozen=True)
class Motion:
    """A rigid object's pose since first touch: depth inwards, slide (x, y), turn about z."""

    depth_mm: float
    slide_mm: tuple[float, float] = (0.0, 0.0)
    turn_rad: float = 0.0


@dataclass(frozen=True)
class CellForces:
    """``press_N`` (C,) inwards and ``shear_N`` (2, C) of the object on each cell of the skin."""

    press_N: np.ndarray
    shear_N: np.ndarray


class FrictionContact:
    """One pad: the compliance of its skin and where its cells are."""

    def __init__(self, skin: np.ndarray, position_mm: np.ndarray, friction: float = 1.0) -> None:
        """Take (3, C, 3, C) mm per newton, (C, 2) centres and Coulomb's coefficient."""
        self._skin, self._position_mm, self._friction = (
            skin.astype(np.float64),
            position_mm,
            friction,
        )

    def follow(self, gap_mm: np.ndarray, path: list[Motion]) -> list[CellForces]:
        """Return the forces at each pose of ``path``; (C,) gaps: 0 touches first, inf is beyond."""
        # bulging gel may rise to it
        near = np.flatnonzero(gap_mm < max(m.depth_mm for m in path) * 1.5 + 0.05)
        part = _Part(
            self._skin[:, near][..., near], gap_mm[near], self._position_mm[near], self._friction
        )
        found = []
        for motion in path:
            press, shear = part.step(motion)
            whole = CellForces(np.zeros(len(gap_mm)), np.zeros((2, len(gap_mm))))
            whole.press_N[near], whole.shear_N[:, near] = press, shear
            found.append(whole)
        return found


class _Part:
    """The cells an object can reach, and what they carried after the last step."""

    def __init__(
        self, skin: np.ndarray, gap_mm: np.ndarray, position_mm: np.ndarray, friction: float
    ) -> None:
        n = len(gap_mm)
        self._normal = skin[2, :, 2]
        self._inward_by_shear = skin[2][:, :2].reshape(n, 2 * n)
        self._sideways_by_press = skin[:2, :, 2].reshape(2 * n, n)
        self._sideways = skin[:2, :, :2].reshape(2 * n, 2 * n)
        self._step_N_per_mm = 1 / np.linalg.eigvalsh(self._sideways)[-1]
        self._gap_mm, self._arm_mm, self._friction = gap_mm, position_mm, friction
        self._press, self._shear, self._object_mm = np.zeros(n), np.zeros(2 * n), np.zeros(2 * n)
        self._factored: tuple[np.ndarray, object] = (np.empty(0, int), None)

    def step(self, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        slide = np.asarray(motion.slide_mm)[:, None]
        moved = slide + motion.turn_rad * np.stack([-self._arm_mm[:, 1], self._arm_mm[:, 0]])
        increment, self._object_mm = moved.ravel() - self._object_mm, moved.ravel()
        press_before, shear_before = self._press, self._shear
        press, shear = press_before, shear_before
        for _ in range(_TURNS):
            last = press
            press = self._pressed(
                motion.depth_mm - self._gap_mm - self._inward_by_shear @ shear, press
            )
            due = increment - self._sideways_by_press @ (press - press_before)
            shear = self._dragged(due, shear, shear_before, press)
            if np.abs(press - last).max() <= _CLOSE * max(press.max(), 1e-9):
                break
        self._press, self._shear = press, shear
        return press, shear.reshape(2, -1)

    def _pressed(self, overlap_mm: np.ndarray, press: np.ndarray) -> np.ndarray:
        """Return forces ≥ 0 that keep the skin out of the object, by how far each cell is in."""
        active = press > 0 if press.any() else overlap_mm > 0
        for _ in range(_ACTIVE_ROUNDS):
            press = np.zeros_like(overlap_mm)
            cells = np.flatnonzero(active)
            if not len(cells):
                break
            press[cells] = cho_solve(self._factor(cells), overlap_mm[cells])
            inside = overlap_mm - self._normal @ press > 1e-9
            now = (active & (press > 0)) | (~active & inside)
            if (now == active).all():
                break
            active = now
        return np.maximum(press, 0)

    def _factor(self, cells: np.ndarray) -> object:
        """Return the factorised compliance of some cells; they seldom change between turns."""
        if not np.array_equal(self._factored[0], cells):
            self._factored = (cells, cho_factor(self._normal[np.ix_(cells, cells)], lower=True))
        return self._factored[1]

    def _dragged(
        self, due_mm: np.ndarray, shear: np.ndarray, before: np.ndarray, press: np.ndarray
    ) -> np.ndarray:
        """Return tangential forces: the skin follows ``due_mm`` as far as friction allows."""
        cells = np.flatnonzero(press > 0)
        found = np.zeros_like(shear)
        if not len(cells):
            return found
        rows = np.concatenate([cells, len(press) + cells])
        sideways, limit = self._sideways[np.ix_(rows, rows)], self._friction * press[cells]
        # what slipped out of contact still pulled before
        let_go = np.delete(np.arange(len(shear)), rows)
        due = due_mm[rows] + self._sideways[np.ix_(rows, let_go)] @ before[let_go]
        still_N = _STILL * limit.max()
        force = point = _capped(shear[rows], limit)
        momentum = 1.0
        for _ in range(_GRADIENT_STEPS):
            error = sideways @ (point - before[rows]) - due
            new = _capped(point - error * self._step_N_per_mm, limit)
            if (point - new) @ (new - force) > 0:
                momentum = 1.0  # it overshot: begin anew
            grown = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            point = new + (momentum - 1) / grown * (new - force)
            still = np.abs(new - force).max() < still_N
            force, momentum = new, grown
            if still:
                break
        found[rows] = force
        return found


def _capped(shear: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return (2·n,) forces whose length on each cell is at most ``limit`` (n,)."""
    by_cell = shear.reshape(2, -1)
    length = np.hypot(*by_cell)
    return (by_cell * np.minimum(1, limit / np.maximum(length, 1e-15))).ravel()
