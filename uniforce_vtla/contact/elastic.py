"""Elastic pads by finite elements: how skin and markers move per newton on each cell of the skin.

Small strain, trilinear hexahedra. The volumetric term is taken at the element's centre, or nearly
incompressible gel locks. The back is bonded, the rim of a dome clamped. Checked against theory by
``benchmarks.finite_elements``. Axes are the image's: x right, y down, z into the pad.
"""

import hashlib
import itertools
import json
import logging
import os
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from filelock import FileLock
from tqdm import tqdm

from uniforce_vtla.array_file import read_arrays
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.sensors.material import Layer

logger = logging.getLogger(__name__)

VERSION = 1  # of the equations below; a cached file of another one isn't read
# a home that is missing or read-only, a file of another user, a full disk, no locks, half a file
UNUSABLE = (OSError, RuntimeError, NotImplementedError, DatasetError)
_HEIGHTS = 6  # element layers at least; twice as many move a marker by less than 2 %
_SPLIT_MM = 1e-6


@dataclass(frozen=True)
class Gel:
    """The body of a pad, in physical numbers."""

    size_mm: tuple[float, float]  # (x, y) extent; a dome's diameter twice
    layers: tuple[Layer, ...]  # from the skin inwards
    # depth below the skin of what is observed: printed markers, roots of pins, magnets
    readout_mm: float
    dome_radius_mm: float | None = None  # radius of curvature of the skin; None for a flat pad
    cell_mm: float = 1.0  # side of the cells that carry traction

    @property
    def thickness_mm(self) -> float:
        """All layers together; of a dome, at its rim."""
        return sum(layer.thickness_mm for layer in self.layers)


@dataclass(frozen=True)
class Influence:
    """Displacement in mm per newton on each of C cells; linear, so that tractions superpose."""

    # (3, C, 3, C) mean displacement of each cell; [axis, cell, axis of force, loaded cell]
    skin: np.ndarray
    inside: np.ndarray  # (3, rows, columns, 3, C) displacement of the nodes at the readout depth
    x_mm: np.ndarray  # (columns,) of those nodes
    y_mm: np.ndarray  # (rows,)

    @cached_property
    def fields(self) -> np.ndarray:
        """Return (rows, columns, 6, 3, C) per newton: u, v, w [mm], ∂u/∂x + ∂v/∂y, ∂w/∂x, ∂w/∂y."""
        u, v, w = self.inside
        strain = np.gradient(u, self.x_mm, axis=1) + np.gradient(v, self.y_mm, axis=0)
        slope_x = np.gradient(w, self.x_mm, axis=1)
        slope_y = np.gradient(w, self.y_mm, axis=0)
        return np.stack([u, v, w, strain, slope_x, slope_y], axis=2).astype(np.float32)


def cache_folder() -> Path:
    """Return the folder of influence matrices, in ``$XDG_CACHE_HOME`` or ``~/.cache``."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "uniforce_vtla" / "influence"


@lru_cache(maxsize=16)
def influence(gel: Gel) -> Influence:
    """Return the influence matrices of ``gel``, cached; the first time takes some ten seconds."""
    key = hashlib.sha256(json.dumps([VERSION, asdict(gel)]).encode()).hexdigest()[:16]
    path = cache_folder() / f"{key}.npz"
    try:
        try:
            return _cached(path, gel)
        except DatasetError as error:
            logger.warning("a damaged file of the cache of pads is made anew: %s", error)
            path.unlink(missing_ok=True)
            return _cached(path, gel)
    except UNUSABLE as error:
        do = "It is computed anew each time; set XDG_CACHE_HOME to a folder of yours."
        logger.warning("%s", expected("cache of pads", "one to read and write", repr(error), do))
        return compute_influence(gel)


def _cached(path: Path, gel: Gel) -> Influence:
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(path.with_suffix(".lock")):  # several processes want the same pad at once
            if not path.exists():
                part = path.with_suffix(".part.npz")
                np.savez(part, **vars(compute_influence(gel)))
                part.replace(path)
    return Influence(**read_arrays(path, ("skin", "inside", "x_mm", "y_mm")))


def compute_influence(gel: Gel, progress: bool = True) -> Influence:
    """Return the influence matrices of ``gel``: solve a quarter of its cells, mirror the rest."""
    mesh = PadMesh(gel)
    rows, columns = mesh.cell_shape
    C = int(mesh.inside.sum())
    cell_of = np.full((rows, columns), -1)
    cell_of[mesh.inside] = np.arange(C)
    skin = np.zeros((3, C, 3, C), np.float32)
    inside = np.zeros((3, rows + 1, columns + 1, 3, C), np.float32)
    cells = np.argwhere(mesh.inside)
    quarter = cells[(2 * cells < (rows, columns)).all(axis=1)]  # the others are its mirrors
    for j, i in tqdm(
        quarter, desc="finite elements of a pad", unit="cell", disable=not progress, leave=False
    ):
        top, deep = mesh.response(j, i)
        for way_y, way_x in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            c = cell_of[::way_y, ::way_x][j, i]
            axes = np.array([way_x, way_y, 1.0])
            sign = axes[:, None, None, None] * axes  # of motion along and force along each axis
            skin[:, :, :, c] = _cell_means(top[:, ::way_y, ::way_x] * sign)[:, mesh.inside]
            inside[..., c] = deep[:, ::way_y, ::way_x] * sign
    return Influence(skin, inside, mesh.x_mm, mesh.y_mm)


def _cell_means(nodes: np.ndarray) -> np.ndarray:
    """Return (3, rows, columns, 3) means of the four corner nodes of each cell."""
    return (nodes[:, 1:, 1:] + nodes[:, :-1, 1:] + nodes[:, 1:, :-1] + nodes[:, :-1, :-1]) / 4


def cell_edges(length_mm: float, cell_mm: float) -> np.ndarray:
    """Return borders of cells: multiples of ``cell_mm`` about 0, and the remainder at both ends."""
    half = length_mm / 2
    whole = np.floor(half / cell_mm + _SPLIT_MM)
    edges = np.arange(-whole, whole + 1) * cell_mm
    if half - whole * cell_mm > _SPLIT_MM:
        edges = np.concatenate([[-half], edges, [half]])
    return edges


def cell_centres(x_mm: np.ndarray, y_mm: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return x and y of the cells between borders, (rows, columns) each."""
    return np.meshgrid((x_mm[1:] + x_mm[:-1]) / 2, (y_mm[1:] + y_mm[:-1]) / 2)


class PadMesh:
    """Hexahedra of one gel, its stiffness matrix factorised."""

    def __init__(self, gel: Gel) -> None:
        # .4 s to import, and the cache seldom misses
        from skfem import Basis, ElementHex1, ElementVector, MeshHex

        self.x_mm = cell_edges(gel.size_mm[0], gel.cell_mm)
        self.y_mm = cell_edges(gel.size_mm[1], gel.cell_mm)
        self.cell_shape = (len(self.y_mm) - 1, len(self.x_mm) - 1)
        levels = _levels(gel)
        grid = MeshHex.init_tensor(self.x_mm, self.y_mm, levels)
        self.inside = np.ones(self.cell_shape, dtype=bool)
        if gel.dome_radius_mm:
            self.inside = np.hypot(*cell_centres(self.x_mm, self.y_mm)) <= gel.size_mm[0] / 2
        centre = grid.p[:, grid.t].mean(axis=1)
        column = np.searchsorted(self.x_mm, centre[0]) - 1
        row = np.searchsorted(self.y_mm, centre[1]) - 1
        grid = grid.restrict(np.flatnonzero(self.inside[row, column]))
        level = np.searchsorted(levels, grid.p[2] - _SPLIT_MM)
        self._node = np.full((len(levels), len(self.y_mm), len(self.x_mm)), -1)
        row = np.searchsorted(self.y_mm, grid.p[1] - _SPLIT_MM)
        column = np.searchsorted(self.x_mm, grid.p[0] - _SPLIT_MM)
        self._node[level, row, column] = np.arange(grid.p.shape[1])
        fixed = level == len(levels) - 1
        if gel.dome_radius_mm:
            fixed |= self._rim()[row, column]
        layer = _layer_of(gel, grid.p[2][grid.t].mean(axis=0))
        mesh = MeshHex(_bent(gel, grid.p), grid.t)
        element = ElementVector(ElementHex1())
        basis = Basis(mesh, element, intorder=3)
        centre_only = Basis(mesh, element, quadrature=(np.full((3, 1), 0.5), np.ones(1)))
        stiffness = _stiffness(basis, centre_only, [gel.layers[k] for k in layer])
        self._dofs = basis.nodal_dofs
        free = np.setdiff1d(np.arange(basis.N), self._dofs[:, fixed].ravel())
        self._place = np.full(basis.N, -1)
        self._place[free] = np.arange(len(free))
        self._free = free
        self._solve = _factorised(stiffness[free][:, free])
        held = [np.setdiff1d(self._dofs[axis], free) for axis in range(3)]
        self._reaction = [stiffness[rows][:, free] for rows in held]
        self._readout = int(np.searchsorted(levels, gel.readout_mm - _SPLIT_MM))

    def _rim(self) -> np.ndarray:
        """Return (rows, columns) bool: nodes on the border of the disc of cells."""
        padded = np.pad(self.inside, 1)
        around = padded[1:, 1:].astype(int) + padded[:-1, 1:] + padded[1:, :-1] + padded[:-1, :-1]
        return (around > 0) & (around < 4)

    def response(self, row: int, column: int) -> tuple[np.ndarray, np.ndarray]:
        """Return motion of skin and readout nodes, (3, rows, columns, 3) each, per N on a cell."""
        moved = self._moved(row, column)
        return self._at_level(moved, 0), self._at_level(moved, self._readout)

    def reaction(self, row: int, column: int) -> np.ndarray:
        """Return (3, 3) force on the mount, [axis, axis of 1 N on a cell]: ideally the identity."""
        moved = self._moved(row, column)[self._free]
        return -np.stack([(rows @ moved).sum(axis=0) for rows in self._reaction])

    def _moved(self, row: int, column: int) -> np.ndarray:
        corners = self._node[0, row : row + 2, column : column + 2].ravel()
        load = np.zeros((len(self._free), 3))
        for axis in range(3):
            place = self._place[self._dofs[axis, corners]]
            load[place[place >= 0], axis] = 0.25  # a clamped node hands its share to the mount
        moved = np.zeros((len(self._place), 3))
        moved[self._free] = self._solve(load)
        return moved

    def _at_level(self, moved: np.ndarray, level: int) -> np.ndarray:
        nodes = self._node[level]
        field = moved[self._dofs[:, nodes]]  # (3, rows, columns, 3)
        return np.where((nodes >= 0)[None, :, :, None], field, 0)


def _levels(gel: Gel) -> np.ndarray:
    """Return depths of the node layers: skin, borders of materials, readout, and some between."""
    borders = np.cumsum([0.0, *(layer.thickness_mm for layer in gel.layers)])
    wanted = np.unique(np.round([*borders, gel.readout_mm], 6))
    largest = gel.thickness_mm / (_HEIGHTS - 1)
    parts = []
    for a, b in itertools.pairwise(wanted):
        parts.append(np.linspace(a, b, max(1, round((b - a) / largest)), endpoint=False))
    return np.concatenate([*parts, wanted[-1:]])


def _layer_of(gel: Gel, depth_mm: np.ndarray) -> np.ndarray:
    return np.searchsorted(np.cumsum([layer.thickness_mm for layer in gel.layers]), depth_mm)


def _bent(gel: Gel, point_mm: np.ndarray) -> np.ndarray:
    """Return (3, N) nodes bent to a dome: the skin follows the sphere, the back stays flat."""
    if gel.dome_radius_mm is None:
        return point_mm
    x, y, depth = point_mm
    top = sagitta_mm(np.minimum(np.hypot(x, y), gel.size_mm[0] / 2), gel.dome_radius_mm)
    back = gel.thickness_mm + sagitta_mm(gel.size_mm[0] / 2, gel.dome_radius_mm)
    skin = gel.layers[0].thickness_mm
    below = (depth - skin) / (gel.thickness_mm - skin)
    z = np.where(depth <= skin, top + depth, top + skin + below * (back - top - skin))
    return np.stack([x, y, z])


def sagitta_mm(radius_mm: np.ndarray | float, dome_radius_mm: float) -> np.ndarray:
    """Return how far a dome's skin lies behind its tangent plane at this distance from the axis."""
    return dome_radius_mm - np.sqrt(np.maximum(dome_radius_mm**2 - np.square(radius_mm), 0))


# scikit-fem has no types
def _stiffness(basis, centre_only, layers: list[Layer]):  # type: ignore[no-untyped-def]
    """Return the sparse stiffness matrix in N/mm: shear in full, volume change at the centres."""
    from skfem import BilinearForm
    from skfem.helpers import ddot, div, sym_grad

    young = np.array([layer.young_MPa for layer in layers])
    poisson = np.array([layer.poisson for layer in layers])
    shear = young / (2 + 2 * poisson)
    bulk = young / (3 - 6 * poisson)

    @BilinearForm
    def change_of_shape(u, v, w):  # type: ignore[no-untyped-def]
        return 2 * w.shear * (ddot(sym_grad(u), sym_grad(v)) - div(u) * div(v) / 3)

    @BilinearForm
    def change_of_volume(u, v, w):  # type: ignore[no-untyped-def]
        return w.bulk * div(u) * div(v)

    def at_points(b, value: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
        return np.repeat(value[:, None], b.X.shape[1], axis=1)

    of_shape = change_of_shape.assemble(basis, shear=at_points(basis, shear))
    of_volume = change_of_volume.assemble(centre_only, bulk=at_points(centre_only, bulk))
    return of_shape + of_volume


def _factorised(matrix):  # type: ignore[no-untyped-def]
    from scipy.sparse.linalg import splu

    return splu(
        matrix.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        options={"SymmetricMode": True},
        diag_pivot_thresh=0.0,
    ).solve
