"""Does a flat gel show the grip of an object that covers it?  Finite elements and the simulator."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.finite_elements.calibrated import encode
from benchmarks.finite_elements.covered_slab import Face, PressedSlab, Slab
from benchmarks.finite_elements.friction import CellForces, FrictionContact, Motion
from benchmarks.finite_elements.theory import cell_centres_mm
from uniforce_cli.boundary import command
from uniforce_vtla.contact import TactileSimulator, flat_face_gap, free_air
from uniforce_vtla.contact.elastic import Gel, influence
from uniforce_vtla.contact.indenters import flat_gap
from uniforce_vtla.contact.responses import ContactOptions, PointMotion
from uniforce_vtla.contact.sampling import ForceRange, HELD_SIDES_mm, HELD_TILT_rad
from uniforce_vtla.contact.simulator import images_of
from uniforce_vtla.contact.traction import Traction, transmitted
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.options import Count, OutFile, Seed, TokenizerFolder
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.sensors.layouts import rectangular
from uniforce_vtla.sensors.material import Layer
from uniforce_vtla.tokenizer import Tokenizer

LOADS_N = (2.0, 5.0, 10.0, 15.0, 20.0)
CAMERA_mm = 30.0  # from the markers to the optical centre: assumed, as in the simulator
NEAR_CAMERA_mm = 20.0
FRICTIONS = (0.5, 1.0)
# films of GelSight Minis on a flat hard box; the head of the tokenizer read the loads, no scale
REAL: dict[str, Any] = {
    "dilation_percent": (0.57, 0.66),
    "noise_percent": 0.02,
    "rim_film_px": (2.0, 3.0),
    "read_N": (5.0, 19.0),
}
SIGNIFICANT = 3  # times the noise: then a picture shows it
CANONICAL_px_per_mm = 24.0
FILM_px_per_mm = 320 / 18.6  # the Mini's view fills a film of 320×240
LARGEST = ForceRange()  # of a held tool's loads
SLIDE_mm = 0.3  # of a solved tool; carries up to some 8 N
TURN_rad = 0.03


@dataclass
class CoveredGelCommand:
    """Press a plate on a gel that it covers: with which walls and friction do the markers show it?

    Example: python -m benchmarks.finite_elements.covered_gel out=docs/results/covered_gel.json
    """

    faces: Count = 40  # held tools solved step by step, pressed, then sheared too; 2 s each
    seed: Seed = 3
    tokenizer: TokenizerFolder = ""  # checkpoint folder; empty = shipped
    out: OutFile = "outputs/covered_gel.json"


@dataclass(frozen=True)
class MarkedGel:
    """A slab with markers at one depth."""

    slab: Slab
    layout_mm: np.ndarray  # (M, 2)
    readout_mm: float

    def gel(self, cell_mm: float) -> Gel:
        """Return the body as the simulator's finite elements take it: with free walls."""
        layer = Layer(self.slab.thickness_mm, self.slab.young_MPa, self.slab.poisson)
        return Gel(self.slab.size_mm, (layer,), self.readout_mm, cell_mm=cell_mm)


GELSIGHT = MarkedGel(Slab((25.0, 25.0), 4.0, 0.5, 0.48), rectangular(8, 10, (2.5, 2.5)), 0.5)
_MINI = Slab((18.6, 14.3), 4.0, 0.5, 0.48)  # the maker's view; the rest is assumed
_MINI_MM = rectangular(7, 9, (2.0, 2.0))
GELS = {
    "gelsight_2017": GELSIGHT,
    "mini": MarkedGel(_MINI, _MINI_MM, 0.5),
    "mini_poisson_49": MarkedGel(replace(_MINI, poisson=0.49), _MINI_MM, 0.5),
    "mini_gel_3_mm_beyond_the_view": MarkedGel(replace(_MINI, size_mm=(24.6, 20.3)), _MINI_MM, 0.5),
}


def seen_mm(layout_mm: np.ndarray, moved_mm: np.ndarray, camera_mm: float) -> np.ndarray:
    """Return (M, 2) motion that a camera sees of (M, 3) displacements: what comes nearer grows."""
    return moved_mm[:, :2] + layout_mm * moved_mm[:, 2:] / camera_mm


def dilation_percent(layout_mm: np.ndarray, motion_mm: np.ndarray) -> np.ndarray:
    """Return (...) divergence of an affine fit to (..., M, 2) motion: growth of area, not of length."""
    fit = np.linalg.pinv(np.column_stack([np.ones(len(layout_mm)), layout_mm]))[1:]  # (2, M)
    return np.asarray(100 * np.einsum("km,...mk->...", fit, motion_mm))


def dilation_noise_percent(layout_mm: np.ndarray, noise_mm: float) -> float:
    """Return the dilation's standard deviation if markers err by ``noise_mm`` along each axis."""
    spread = ((layout_mm - layout_mm.mean(axis=0)) ** 2).sum(axis=0)
    return float(100 * noise_mm * np.sqrt((1 / spread).sum()))


def rim_mm(layout_mm: np.ndarray, motion_mm: np.ndarray) -> float:
    """Return the mean outward motion of the first and last columns of markers."""
    x_mm = layout_mm[:, 0]
    rim = np.abs(x_mm) == np.abs(x_mm).max()
    return float((np.sign(x_mm[rim]) * motion_mm[rim, 0]).mean())


def describe(layout_mm: np.ndarray, moved_mm_per_N: np.ndarray) -> dict[str, Any]:
    """Return what a marker image shows of the load, given (M, 3) displacements per newton."""
    seen = seen_mm(layout_mm, moved_mm_per_N, CAMERA_mm)
    seen_near = seen_mm(layout_mm, moved_mm_per_N, NEAR_CAMERA_mm)
    slope = float(dilation_percent(layout_mm, seen))
    sideways = float(dilation_percent(layout_mm, moved_mm_per_N[:, :2]))
    rim = rim_mm(layout_mm, seen)
    real_N = float(np.mean(REAL["dilation_percent"])) / slope
    return {
        "dilation_percent_per_N": slope,
        "dilation_percent_per_N_near_camera": float(dilation_percent(layout_mm, seen_near)),
        "share_of_magnification": 1 - sideways / slope,
        "load_seen_N": SIGNIFICANT * REAL["noise_percent"] / slope,
        "load_of_real_dilation_N": real_N,
        "rim_film_px_at_real_dilation": real_N * rim * FILM_px_per_mm,
        "loads": {
            f"{load:g} N": {
                "dilation_percent": load * slope,
                "over_real_noise": load * slope / REAL["noise_percent"],
                "rim_px": load * rim * CANONICAL_px_per_mm,
                "rim_film_px": load * rim * FILM_px_per_mm,
            }
            for load in LOADS_N
        },
    }


def bounds(gel: MarkedGel) -> dict[str, Any]:
    """Return a slab's rows for free and fixed walls, sliding and sticking to the plate."""
    found = {}
    rows: tuple[tuple[str, Face, bool], ...] = (
        ("walls fixed", "sticking", False),  # sliding is the same: nothing moves sideways
        ("walls free, no friction", "sliding", True),
        ("walls free, sticking", "sticking", True),
    )
    for name, face, free in rows:
        pressed = PressedSlab(gel.slab, face, (free, free))
        moved = pressed.motion(gel.layout_mm, gel.readout_mm)
        stiffness = {"stiffness_N_per_mm": pressed.stiffness_N_per_mm}
        found[name] = stiffness | describe(gel.layout_mm, moved)
    return found


def with_friction(gel: MarkedGel, friction: float, cell_mm: float = 1.25) -> dict[str, Any]:
    """Return a slab's row for Coulomb's friction, its walls free, on the simulator's elements."""
    body = gel.gel(cell_mm)
    compliance = influence(body)
    position_mm = cell_centres_mm(body)
    depth_mm = 0.05
    solver = FrictionContact(compliance.skin, position_mm, friction)
    forces = solver.follow(np.zeros(len(position_mm)), [Motion(depth_mm)])[0]
    press_N = forces.press_N.sum()
    respond = PointMotion(compliance, gel.layout_mm, 1 / press_N)
    moved = respond(_traction(forces))[0, :3].T
    return {"stiffness_N_per_mm": float(press_N / depth_mm)} | describe(gel.layout_mm, moved)


def _traction(forces: CellForces) -> Traction:
    press_N = forces.press_N[None].astype(np.float32)
    shear_N = forces.shear_N[None].astype(np.float32)
    return Traction(np.arange(press_N.shape[1]), press_N, shear_N)


class SimulatedGrip:
    """The shipped model of a GelSight whose pad a held tool covers."""

    def __init__(self) -> None:
        self._simulator = TactileSimulator("gelsight", options=ContactOptions().quiet())
        self.layout_mm = self._simulator.spec.layout_mm
        self._rest_px = self._simulator.markers_px(free_air(1))[0]

    def motion_mm(self, contact: ContactState) -> np.ndarray:
        """Return (B, M, 2) motion of markers as the camera sees it."""
        return (self._simulator.markers_px(contact)[0] - self._rest_px) / CANONICAL_px_per_mm

    def rows(self) -> dict[str, Any]:
        """Return dilation and rim under a straight plate by load, under a tilt, and near an edge."""
        straight = {f"{load:g} N": self._row((0.0, 0.0), 0.0, load) for load in LOADS_N}
        tilted = {
            f"10 N, tilted by {tilt} rad": self._row((0.0, 0.0), tilt, 10.0)
            for tilt in (0.002, 0.005, 0.01)
        }
        # the plate ends where the pad does
        centre_mm = (GELSIGHT.slab.size_mm[0] - HELD_SIDES_mm[0]) / 2
        ends = {
            f"10 N, ends {cut} mm before the rim": self._row((centre_mm - cut, 0.0), 0.0, 10.0)
            for cut in (2, 4)
        }
        return straight | tilted | ends

    def _row(
        self, center_mm: tuple[float, float], tilt_rad: float, load_N: float
    ) -> dict[str, float]:
        tilts_rad = np.array([[tilt_rad, 0.0]])
        gap = flat_face_gap(
            np.array([center_mm]), np.array([HELD_SIDES_mm]), np.zeros(1), tilts_rad
        )
        motion = self.motion_mm(_state(gap, np.array([[0, 0, load_N]]), np.zeros(1)))[0]
        x_mm = self.layout_mm[:, 0]
        left_mm = motion[x_mm == x_mm.min(), 0].mean()
        right_mm = motion[x_mm == x_mm.max(), 0].mean()
        return {
            "dilation_percent": float(dilation_percent(self.layout_mm, motion)),
            "rim_left_px": float(-left_mm * CANONICAL_px_per_mm),
            "rim_right_px": float(right_mm * CANONICAL_px_per_mm),
        }

    def read_grip(
        self, known: ContactState, unseen: ContactState, rng: np.random.Generator, noise_px: float
    ) -> dict[str, dict[str, float]]:
        """Return R² and mean error of grip, read by ridge from the dilation and from all markers."""
        known_mm = self._noisy_mm(known, rng, noise_px)
        unseen_mm = self._noisy_mm(unseen, rng, noise_px)
        known_dilation = dilation_percent(self.layout_mm, known_mm)[:, None]
        unseen_dilation = dilation_percent(self.layout_mm, unseen_mm)[:, None]
        known_N = known.force_N[:, 2]
        unseen_N = unseen.force_N[:, 2]
        return {
            "dilation": _ridge_score(known_dilation, known_N, unseen_dilation, unseen_N),
            "markers": _ridge_score(_rows(known_mm), known_N, _rows(unseen_mm), unseen_N),
        }

    def _noisy_mm(
        self, contact: ContactState, rng: np.random.Generator, noise_px: float
    ) -> np.ndarray:
        motion = self.motion_mm(contact)
        return motion + rng.standard_normal(motion.shape) * noise_px / CANONICAL_px_per_mm


def latents_of(tokenizer: Tokenizer, contact: ContactState, seed: int) -> np.ndarray:
    """Return (n, P·L) pooled latents of marker images with the simulator's usual noise."""
    simulator = TactileSimulator("gelsight", seed=seed)
    images = images_of(simulator, contact)
    latent = encode(tokenizer, as_virtual("gelsight"), simulator.reference(), images)
    return _rows(np.asarray(latent.as_subclass(torch.Tensor)))


def held_tools_loaded(rng: np.random.Generator, n: int, sheared: bool) -> ContactState:
    """Return tools that cover the pad, with grip even over the range, and shear and twist if asked."""
    grip_N = rng.uniform(0, LARGEST.normal_N, n)
    angle = rng.uniform(-np.pi, np.pi, n)
    share = rng.random(n) * sheared
    shear_N = np.minimum(LARGEST.friction * grip_N, LARGEST.shear_N) * share
    twist = rng.uniform(-1, 1, n) * sheared * np.sqrt(1 - share**2)
    force_N = np.column_stack([shear_N * np.cos(angle), shear_N * np.sin(angle), grip_N])
    torsion_Nmm = twist * grip_N * LARGEST.flat_torsion_arm_mm
    return _state(flat_face_gap(*_held_faces(rng, n)), force_N, torsion_Nmm)


def _state(gap_mm: np.ndarray, force_N: np.ndarray, torsion_Nmm: np.ndarray) -> ContactState:
    return ContactState(gap_mm, force_N.astype(np.float32), torsion_Nmm.astype(np.float32))


def _rows(value: np.ndarray) -> np.ndarray:
    return value.reshape(len(value), -1)


def _held_faces(
    rng: np.random.Generator, n: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return centres, sizes, angles and tilts as ``held_tools`` draws them."""
    center_mm = np.column_stack([rng.uniform(-3, 3, n), rng.uniform(-5, 5, n)])
    tilt_rad = rng.uniform(-HELD_TILT_rad, HELD_TILT_rad, (n, 2))
    return center_mm, np.full((n, 2), HELD_SIDES_mm), rng.uniform(-0.05, 0.05, n), tilt_rad


def _ridge_score(
    known: np.ndarray, known_N: np.ndarray, asked: np.ndarray, asked_N: np.ndarray
) -> dict[str, float]:
    """Return R² and mean error on (n, F) rows that a ridge of 1 on other, scaled rows didn't see."""
    mean = known.mean(axis=0)
    scale = known.std(axis=0)
    known = (known - mean) / scale
    asked = (asked - mean) / scale
    known_mean_N = known_N.mean()
    penalty = np.eye(known.shape[1])
    weight = np.linalg.solve(known.T @ known + penalty, known.T @ (known_N - known_mean_N))
    error_N = asked @ weight + known_mean_N - asked_N
    return {
        "r2": float(1 - (error_N**2).mean() / asked_N.var()),
        "error_N": float(np.abs(error_N).mean()),
    }


def held_tools_solved(
    rng: np.random.Generator, n: int, sheared: bool, fast: SimulatedGrip
) -> dict[str, float]:
    """Return how dilation follows grip: with friction solved step by step, and in the simulator."""
    body = GELSIGHT.gel(1.25)
    compliance = influence(body)
    position_mm = cell_centres_mm(body)
    solver = FrictionContact(compliance.skin, position_mm, 1.0)
    respond = PointMotion(compliance, GELSIGHT.layout_mm, 1.0)
    rows = []
    for _ in range(n):
        face = _held_faces(rng, 1)
        gap = flat_gap(*face, position_mm)[0]
        depth_mm = rng.uniform(0.02, 0.1)
        way = rng.uniform(-np.pi, np.pi)
        slide_mm = SLIDE_mm * rng.random() * sheared * np.array([np.cos(way), np.sin(way)])
        turn_rad = rng.uniform(-TURN_rad, TURN_rad) * sheared
        path = [Motion(depth_mm * part) for part in (0.25, 0.5, 0.75, 1)]
        path += [
            Motion(depth_mm, tuple(slide_mm * part), turn_rad * part) for part in (1 / 3, 2 / 3, 1)
        ]
        state = solver.follow(gap - gap.min(), path)[-1]
        solved = respond(_traction(state))[0, :3].T
        force_N, torsion = transmitted(state.press_N[None], state.shear_N[None], position_mm)
        motion = fast.motion_mm(_state(flat_face_gap(*face), force_N, torsion))[0]
        seen = [seen_mm(GELSIGHT.layout_mm, solved, CAMERA_mm), motion]
        rows.append([force_N[0, 2], *(dilation_percent(GELSIGHT.layout_mm, m) for m in seen)])
    grip_N, by_elements, by_simulator = np.array(rows).T
    return {
        "n": n,
        "r_grip_finite_elements": float(np.corrcoef(grip_N, by_elements)[0, 1]),
        "r_grip_simulator": float(np.corrcoef(grip_N, by_simulator)[0, 1]),
        "r_between": float(np.corrcoef(by_elements, by_simulator)[0, 1]),
    }


def measure(tokenizer: Tokenizer, faces: int, seed: int) -> dict[str, Any]:
    found: dict[str, Any] = {"real": REAL, "camera_mm": CAMERA_mm, "film_px_per_mm": FILM_px_per_mm}
    for name, gel in GELS.items():
        found[name] = bounds(gel) | {
            f"walls free, friction {f:g}": with_friction(gel, f) for f in FRICTIONS
        }
    fast = SimulatedGrip()
    noise_mm = ContactOptions().noise_px / CANONICAL_px_per_mm
    found["simulator"] = {
        "dilation_noise_percent": dilation_noise_percent(fast.layout_mm, noise_mm),
        "one_plate": fast.rows(),
    }
    for name, sheared in (("pressed", False), ("pressed, sheared and twisted", True)):
        rng = np.random.default_rng(seed)
        known = held_tools_loaded(rng, 800, sheared)
        unseen = held_tools_loaded(rng, 300, sheared)
        read: dict[str, Any] = {
            f"{noise_px:.2f} px a marker": fast.read_grip(known, unseen, rng, noise_px)
            for noise_px in (0.0, real_noise_px(), ContactOptions().noise_px)
        }
        seen = latents_of(tokenizer, known, seed)
        asked = latents_of(tokenizer, unseen, seed + 1)
        read["latents, 0.30 px a marker"] = _ridge_score(
            seen, known.force_N[:, 2], asked, unseen.force_N[:, 2]
        )
        solved = held_tools_solved(rng, faces, sheared, fast)
        found["simulator"][f"held tools, {name}"] = {"read": read, "dilation": solved}
    return found


def real_noise_px() -> float:
    """Return the noise of a marker, in canonical px, that explains the noise of real dilations."""
    percent_per_mm = dilation_noise_percent(GELS["mini"].layout_mm, 1.0)
    return CANONICAL_px_per_mm * REAL["noise_percent"] / percent_per_mm


@command(CoveredGelCommand)
def main(config: CoveredGelCommand) -> None:
    torch.set_num_threads(1)
    tokenizer = Tokenizer.from_pretrained(config.tokenizer or None)
    content = measure(tokenizer, config.faces, config.seed) | {"tokenizer": tokenizer.hash}
    for gel in GELS:
        for name, row in content[gel].items():
            slope = f"{row['dilation_percent_per_N']:.3f} %/N"
            share = f"{row['share_of_magnification']:.0%} by magnification"
            print(f"{gel:30} {name:26} {row['stiffness_N_per_mm']:5.0f} N/mm {slope}, {share}")
    for name, row in content["simulator"].items():
        print(name, row)
    print(f"written to {write_json(Path(config.out), content | provenance())}")


if __name__ == "__main__":
    sys.exit(main())
