"""Is the finite-element pad right? Contacts of known answer: computed over theory, 1 is right."""

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from benchmarks.finite_elements.friction import CellForces, FrictionContact, Motion
from uniforce_vtla.contact.elastic import Gel, Influence, PadMesh, cell_edges, compute_influence
from uniforce_vtla.sensors.material import Layer

SMOOTH = 1e-6  # friction so small that it doesn't count
_POISSON = 0.48


def cell_centres_mm(gel: Gel) -> np.ndarray:
    """Return (C, 2) centres of the cells of a gel's skin, ordered as its influence matrices."""
    x = cell_edges(gel.size_mm[0], gel.cell_mm)
    y = cell_edges(gel.size_mm[1], gel.cell_mm)
    grid = np.meshgrid((x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2)
    centre = np.stack(grid, axis=-1).reshape(-1, 2)
    if not gel.dome_radius_mm:
        return centre
    return centre[np.hypot(*centre.T) <= gel.size_mm[0] / 2]


def hertz() -> dict[str, float]:
    """Force of a sphere on a bonded layer over Dimitriadis et al. (Biophys. J. 82, 2002)."""
    radius_mm = 7.0
    thickness_mm = 4.0
    # their layer is incompressible, ours has ν = .48: a percent softer
    gel = Gel((16.0, 16.0), (Layer(thickness_mm, 1.0, _POISSON),), 0.5, cell_mm=0.5)
    depths_mm = (0.3, 0.45, 0.6)
    pressed = _pressed(gel, _sphere_mm(cell_centres_mm(gel), radius_mm), depths_mm)
    found = {}
    for depth_mm, forces in zip(depths_mm, pressed, strict=True):
        wanted_N = _layer_force(depth_mm, radius_mm, thickness_mm)
        found[f"{depth_mm} mm"] = float(forces.press_N.sum() / wanted_N)
    return found


def bonded_layer() -> float:
    """Pressure amid a wide thin layer under a flat face over that of uniaxial strain."""
    thickness_mm = 1.0
    poisson = 0.3
    depth_mm = 0.05
    gel = Gel((16.0, 16.0), (Layer(thickness_mm, 1.0, poisson),), 0.5, cell_mm=0.5)
    position = cell_centres_mm(gel)
    press_N = _pressed(gel, np.zeros(len(position)), (depth_mm,))[0].press_N
    amid = np.hypot(*position.T) < 3
    modulus = (1 - poisson) / (1 + poisson) / (1 - 2 * poisson)
    return float(press_N[amid].mean() / gel.cell_mm**2 / (modulus * depth_mm / thickness_mm))


def cattaneo_mindlin() -> dict[str, float]:
    """Slide of a pressed sphere over theory's for its shear, by that shear's share of friction.

    Theory knows a half-space; our block also shears as a whole. That part is linear in the force
    and is taken from a contact that sticks, so what is checked here is how slip grows.
    """
    radius_mm = 6.0
    friction = 0.5
    depth_mm = 0.35
    gel = Gel((12.0, 12.0), (Layer(8.0, 1.0, _POISSON),), 0.5, cell_mm=0.375)
    position = cell_centres_mm(gel)
    skin = compute_influence(gel, progress=False).skin
    gap_mm = _sphere_mm(position, radius_mm)
    stick = [Motion(depth_mm), Motion(depth_mm, (0.02, 0.0))]
    stuck = FrictionContact(skin, position, 100.0).follow(gap_mm, stick)
    shear_MPa = 1 / (2 + 2 * _POISSON)
    contact_mm = _hertz_radius_mm(stuck[0].press_N.sum(), radius_mm)
    # mm per newton
    whole = 0.02 / stuck[1].shear_N[0].sum() - (2 - _POISSON) / (8 * shear_MPa * contact_mm)
    slides_mm = np.linspace(0.02, 0.16, 8)
    path = [Motion(depth_mm), *(Motion(depth_mm, (float(s), 0.0)) for s in slides_mm)]
    slipping = FrictionContact(skin, position, friction).follow(gap_mm, path)[1:]
    found = {}
    for slide_mm, state in zip(slides_mm, slipping, strict=True):
        press_N = state.press_N.sum()
        shear_N = state.shear_N[0].sum()
        share = shear_N / (friction * press_N)
        contact_mm = _hertz_radius_mm(press_N, radius_mm)
        full = 3 * friction * press_N * (2 - _POISSON) / (16 * shear_MPa * contact_mm)
        local_mm = slide_mm - whole * shear_N
        found[f"{share:.2f}"] = float(local_mm / (full * (1 - (1 - share) ** (2 / 3))))
    return found


def mesh_convergence() -> dict[str, float]:
    """Change of marker motion under a sphere and a punch of 6 N, against cells of .8 mm."""
    finest = _marker_motion(0.8)
    found = {}
    for cell_mm in (1.25, 1.0):
        change = np.linalg.norm(_marker_motion(cell_mm) - finest)
        found[f"{cell_mm}"] = float(change / np.linalg.norm(finest))
    return found


def reciprocity() -> float:
    """Largest difference of the skin's compliance from its transpose, over its largest entry.

    By Maxwell and Betti it is 0.
    """
    skin = compute_influence(Gel((12.0, 12.0), (Layer(4.0, 1.0),), 0.5), progress=False).skin
    n = skin.shape[1] * 3
    square = skin.reshape(n, n)
    return float(np.abs(square - square.T).max() / np.abs(square).max())


def force_balance() -> float:
    """Return the largest difference of a cell's load and what reaches the mount, per newton."""
    mesh = PadMesh(Gel((12.0, 12.0), (Layer(4.0, 1.0),), 0.5))
    cells = ((5, 5), (2, 7), (0, 4))
    return float(max(np.abs(mesh.reaction(*cell) - np.eye(3)).max() for cell in cells))


def _pressed(gel: Gel, gap_mm: np.ndarray, depths_mm: tuple[float, ...]) -> list[CellForces]:
    skin = compute_influence(gel, progress=False).skin
    solver = FrictionContact(skin, cell_centres_mm(gel), SMOOTH)
    return solver.follow(gap_mm, [Motion(depth_mm) for depth_mm in depths_mm])


def _sphere_mm(position_mm: np.ndarray, radius_mm: float) -> np.ndarray:
    r2 = (position_mm**2).sum(axis=1)
    gap = radius_mm - np.sqrt(np.maximum(radius_mm**2 - r2, 0))
    return np.where(r2 < radius_mm**2, gap, np.inf)


def _layer_force(depth_mm: float, radius_mm: float, thickness_mm: float) -> float:
    chi = np.sqrt(radius_mm * depth_mm) / thickness_mm
    series = 1 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4
    return float(16 / 9 * np.sqrt(radius_mm) * depth_mm**1.5 * series)  # E = 1 MPa


def _hertz_radius_mm(press_N: float, radius_mm: float) -> float:
    return float((3 * press_N * radius_mm * (1 - _POISSON**2) / 4) ** (1 / 3))  # E = 1 MPa


def _marker_motion(cell_mm: float) -> np.ndarray:
    """Return displacements .5 mm deep, of a sphere and of a flat punch, 6 N each."""
    gel = Gel((25.0, 25.0), (Layer(4.0, 0.5),), 0.5, cell_mm=cell_mm)
    moved = compute_influence(gel, progress=False)
    position = cell_centres_mm(gel)
    punch = np.where(np.hypot(*position.T) <= 5, 0.0, np.inf)
    fields = [_at_points(moved, gel, gap) for gap in (_sphere_mm(position, 7.0), punch)]
    return np.stack(fields)


def _at_points(moved: Influence, gel: Gel, gap_mm: np.ndarray) -> np.ndarray:
    solver = FrictionContact(moved.skin, cell_centres_mm(gel), 1.0)
    states = solver.follow(gap_mm, [Motion(float(depth)) for depth in np.linspace(0.05, 1.6, 32)])
    state = min(states, key=lambda one: abs(one.press_N.sum() - 6))
    force = np.stack([*state.shear_N, state.press_N]) * 6 / state.press_N.sum()
    field = np.einsum("ayxbc,bc->yxa", moved.inside, force)
    axis = np.arange(-10, 10.1, 2.5)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    return np.asarray(RegularGridInterpolator((moved.y_mm, moved.x_mm), field)(points))
