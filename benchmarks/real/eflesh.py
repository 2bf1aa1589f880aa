"""Real newtons: eFlesh, a printed magnetic skin, read by tokenizers and by its raw counts.

A probe presses one unit (normal_force), or two units side by side under one load (shear_force).
The folders are those of notvenky/eFlesh, characterization/datasets (MIT). Splits are by run or by
time, as hysteresis and drift ask for.

Assumed are: grams as unit of force, for the repository states none; chips on the axes 7 mm from
the middle one, each turned as the authors' viewer turns it; magnets of either polarity, so that
only the size of a normal field counts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.real.readouts import DRAWS, FEW_FRAMES, RIDGES, fit_readout, pooled
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.markers.taxel_render import TaxelScales, draw_discs, place_discs
from uniforce_vtla.sensors import SensorSpec
from uniforce_vtla.sensors.spec import TaxelSignal
from uniforce_vtla.tokenizer import Tokenizer

NORMAL, SHEAR = "normal_force", "shear_force"
# scored once, when the tokenizer is frozen
SEALED = {NORMAL: "20250401_015717_probe", SHEAR: "20250416_201911_probe"}
GRAM_N = 9.81e-3
MISSING = -1.0
CHIPS = 5
MOST_N = 18.0  # that are scored
PITCH_mm = 7.0
# of the middle, left, right, upper and lower chip, towards the pad's axes
TURN_rad = np.array([-np.pi / 2, -np.pi / 2, np.pi, np.pi / 2, 0.0])
EFLESH = SensorSpec(
    name="eflesh",
    # worth: of half, once and twice this half, the one that read a second unit best in the open
    # shear run
    taxels=TaxelSignal(pitch_mm=(PITCH_mm, PITCH_mm), worth=(1.0, 1.0, 4.0), tared=True),
    raw_shape=(CHIPS, 3),
    layout_mm=PITCH_mm * np.array([(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)], np.float32),
    px_per_mm=(160.0 / PITCH_mm, 120.0 / PITCH_mm),  # five discs on the whole canonical image
    marker_shape="disc",
    marker_size_mm=0.6,
    pad_size_mm=(40.3, 40.3),
    rated_depth_mm=2.0,
    source="chips, turns and size: public drivers of AnySkin and eFlesh; depth is assumed",
)
# on a scale: .5, 1 and 1.5 kg. A unit saturates, so that 3 to 9 N say little of 18 N
LOADS_N = (5.0, 10.0, 15.0)
NEAR_N = 0.5  # of a load
FREE_N = 0.05  # and less is free air
STRETCHES = 20  # of each reading, for intervals: neighbouring frames resemble each other
BOOTSTRAPS = 2000


@dataclass(frozen=True)
class Run:
    """One recording of one unit or of two under the same load."""

    name: str
    load: str  # NORMAL or SHEAR
    counts: np.ndarray  # (n, units, 5, 3) µT above free air, as the chips say
    force_N: np.ndarray  # (n,)


@dataclass(frozen=True)
class Part:
    """Frames of one unit."""

    run: str
    unit: int
    rows: slice


@dataclass(frozen=True)
class Case:
    """A readout is fitted to one part and reads another."""

    name: str
    fit: Part
    read: Part
    # of the other unit that is read: earlier frames, for loads and labels; None: own unit
    known: Part | None = None


Features = Callable[[np.ndarray], np.ndarray]  # counts (n, 5, 3) → (n, F)


def read_runs(folder: Path, frames: int, sealed: bool) -> list[Run]:
    """Return the open runs, and the sealed ones where asked for, ``frames`` even rows of each.

    Raises DatasetError: no runs of a load, sealed ones that aren't there, or tables that don't fit.
    """
    runs = []
    for load, closed in SEALED.items():
        found = sorted(path for path in (folder / load).glob("*_probe") if path.name != closed)
        if sealed:
            found.append(folder / load / closed)
        if not found:
            do = "Name characterization/datasets of notvenky/eFlesh."
            raise DatasetError(expected(str(folder / load), "runs", "none", do))
        for path in found:
            runs.append(read_run(path, load, frames))
    return runs


def read_run(folder: Path, load: str, frames: int) -> Run:
    """Return a run without rows of missing force; DatasetError: tables absent or that don't fit."""
    field = _table(folder / "sensor_post_baselines.csv")
    state = _table(folder / "states.csv")
    units, rest = divmod(field.shape[1] - 1, 3 * CHIPS)
    if len(field) != len(state) or state.shape[1] != 5 or units < 1 or rest:
        wanted = f"equal rows, 1 + {3 * CHIPS} columns a unit, and 5"
        came = f"{field.shape} and {state.shape}"
        raise DatasetError(expected(f"tables of {folder}", wanted, came, "Copy the run again."))
    known = np.flatnonzero(state[:, 4] != MISSING)
    rows = known[np.linspace(0, len(known) - 1, min(frames, len(known))).astype(int)]
    counts = field[rows, 1:].reshape(len(rows), units, CHIPS, 3)
    return Run(folder.name, load, counts, state[rows, 4] * GRAM_N)


def _table(path: Path) -> np.ndarray:
    if not path.is_file():
        raise DatasetError(expected(str(path), "a table", "none", "Copy the run again."))
    try:
        return pd.read_csv(path, header=None).to_numpy(np.float64)
    except ValueError as error:
        raise DatasetError(
            expected(str(path), "numbers", str(error)[:80], "Copy the run again.")
        ) from error


def on_the_pad(counts: np.ndarray) -> np.ndarray:
    """Return (n, 5, 3) fields along the pad's axes, the size of the normal one."""
    cos = np.cos(TURN_rad)
    sin = np.sin(TURN_rad)
    x = cos * counts[..., 0] - sin * counts[..., 1]
    y = sin * counts[..., 0] + cos * counts[..., 1]
    return np.stack([x, y, np.abs(counts[..., 2])], axis=-1)


def marker_images(counts: np.ndarray) -> np.ndarray:
    """Return (n, 480, 640) uint8 images of five discs."""
    scales = TaxelScales()
    images = [draw_discs(place_discs(delta, EFLESH, scales)) for delta in on_the_pad(counts)]
    return np.stack(images)


def latent_features(tokenizer: Tokenizer) -> Features:
    """Return the pooled latents of the drawn discs, as features."""
    reference = marker_images(np.zeros((1, CHIPS, 3)))[0]
    return lambda counts: pooled(tokenizer, reference, marker_images(counts))


def raw_features(counts: np.ndarray) -> np.ndarray:
    """Return the fields as they came, (n, 15)."""
    return counts.reshape(len(counts), -1)


def cases_of(runs: Sequence[Run], sealed: bool) -> list[Case]:
    """Return what is fitted to what, and read where: open runs alone, or the sealed ones by them.

    Normal runs: one fits, another is read. Shear runs, open: the first half fits, the second is
    read, the same unit or the other. Sealed: the open runs fit.
    """
    whole = slice(None)
    normal = [run.name for run in runs if run.load == NORMAL]
    cases = []
    for fit, read in permutations(normal, 2):
        if not sealed or read == SEALED[NORMAL]:
            cases.append(Case("own head, normal", Part(fit, 0, whole), Part(read, 0, whole)))
    for run in runs:
        if run.load != SHEAR or run.name == SEALED[SHEAR]:
            continue
        if sealed:
            later_run = SEALED[SHEAR]
            early = late = whole
        else:
            later_run = run.name
            half = len(run.force_N) // 2
            early = slice(half)
            late = slice(half, None)
        for unit in (0, 1):
            other = 1 - unit
            fitted = Part(run.name, unit, early)
            known = Part(run.name, other, early)
            cases.append(Case("own head, shear", fitted, Part(later_run, unit, late)))
            cases.append(Case("other unit's head", fitted, Part(later_run, other, late), known))
    return cases


def absolute_errors(
    case: Case, seen: dict[str, np.ndarray], force_N: dict[str, np.ndarray], ridge: float
) -> dict[str, Any]:
    """Return way of reading → (n,) absolute errors in N of frames up to ``MOST_N``.

    ``seen`` holds the features (n, units, F) of each run, ``force_N`` its forces (n,).
    """

    def of(part: Part) -> tuple[np.ndarray, np.ndarray]:
        return seen[part.run][part.rows, part.unit], force_N[part.run][part.rows]

    readout = fit_readout(*of(case.fit), ridge)
    features, true_N = of(case.read)
    read_N = readout.predict(features)
    scored = true_N <= MOST_N
    if case.known is None:
        return {case.name: np.abs(read_N - true_N)[scored]}
    labelled, known_N = of(case.known)  # (m, F), (m,)
    before_N = readout.predict(labelled)
    rng = np.random.default_rng(0)
    drawn = []
    for _ in range(DRAWS):
        few = rng.choice(len(known_N), FEW_FRAMES, replace=False)
        gain, offset = np.polyfit(before_N[few], known_N[few], 1)
        drawn.append(np.abs(gain * read_N + offset - true_N)[scored])
    return {
        case.name: np.abs(read_N - true_N)[scored],
        "three loads": np.abs(weighed(read_N, before_N, known_N) - true_N)[scored],
        "ten frames": np.mean(drawn, axis=0),
    }


def weighed(read_N: np.ndarray, before_N: np.ndarray, known_N: np.ndarray) -> np.ndarray:
    """Return readings (n,) above those of free air, by the gain that three known loads ask for.

    Raises DatasetError: earlier readings (m,) of known forces that hold no free air or lack a load.
    """
    is_free = known_N < FREE_N
    is_load = {load: np.abs(known_N - load) < NEAR_N for load in LOADS_N}
    near = {0.0: is_free} | is_load
    if missing := [f"{load:.0f}" for load, rows in near.items() if not rows.any()]:
        wanted = f"free air and loads of {LOADS_N} N"
        came = f"none near {', '.join(missing)} N"
        raise DatasetError(
            expected("earlier frames of the other unit", wanted, came, "Read more frames of it.")
        )
    free_N = before_N[is_free].mean()
    above_N = np.array([before_N[rows].mean() for rows in is_load.values()]) - free_N
    true_N = np.array([known_N[rows].mean() for rows in is_load.values()])
    return (read_N - free_N) * (above_N @ true_N) / (above_N @ above_N)


# ridge → way of reading → a case's errors, seed by seed
Errors = dict[str, dict[str, list[np.ndarray]]]


def eflesh_rows(
    folder: Path, tokenizer: Tokenizer, seeds: int, frames: int, sealed: bool
) -> dict[str, Any]:
    """Return row → ridge → way of reading → MAE in N; raises as ``read_runs``.

    "tokenizer − raw counts" holds mean and 95 % interval of the difference, by bootstrap over
    stretches of time.
    """
    runs = read_runs(folder, frames, sealed)
    cases = cases_of(runs, sealed)
    untrained = [latent_features(Tokenizer.random(tokenizer.config, seed)) for seed in range(seeds)]
    errors = {
        "tokenizer": _errors(runs, cases, [latent_features(tokenizer)]),
        "untrained": _errors(runs, cases, untrained),
        "raw counts": _errors(runs, cases, [raw_features]),
    }
    found: dict[str, Any] = {}
    for name, by_ridge in errors.items():
        for ridge, by_way in by_ridge.items():
            means = found.setdefault(name, {}).setdefault(ridge, {})
            for way, of_cases in by_way.items():
                means[way] = float(np.mean([error_N.mean() for error_N in of_cases]))
    for ridge, by_way in errors["tokenizer"].items():
        apart = found.setdefault("tokenizer − raw counts", {}).setdefault(ridge, {})
        for way, of_cases in by_way.items():
            apart[way] = _difference(of_cases, errors["raw counts"][ridge][way])
    return {
        "runs": {run.name: len(run.force_N) for run in runs},
        "force": f"states.csv column 5 × {GRAM_N}: grams are assumed; up to {MOST_N:.0f} N, "
        "free air included",
        "loads_N": list(LOADS_N),
        "sealed": sealed,
        "mae_N": found,
    }


def _errors(runs: Sequence[Run], cases: Sequence[Case], makers: Sequence[Features]) -> Errors:
    force_N = {run.name: run.force_N for run in runs}
    found: Errors = {str(ridge): {} for ridge in RIDGES}
    for features in makers:
        seen = {}  # (n, units, F) each
        for run in runs:
            of_units = [features(run.counts[:, unit]) for unit in range(run.counts.shape[1])]
            seen[run.name] = np.stack(of_units, axis=1)
        for ridge in RIDGES:
            for case in cases:
                for way, error_N in absolute_errors(case, seen, force_N, ridge).items():
                    found[str(ridge)].setdefault(way, []).append(error_N)
    return found


def _difference(of_tokens: Sequence[np.ndarray], of_raw: Sequence[np.ndarray]) -> dict[str, Any]:
    """Return mean and 95 % interval of tokenizer minus raw counts, N, over all cases."""
    stretches = []
    for tokens, raw in zip(of_tokens, of_raw, strict=True):
        for part in np.array_split(tokens - raw, STRETCHES):
            stretches.append(part.mean())
    drawn = np.random.default_rng(0).choice(stretches, (BOOTSTRAPS, len(stretches))).mean(axis=1)
    return {
        "mean": float(np.mean(stretches)),
        "interval_95": np.percentile(drawn, [2.5, 97.5]).tolist(),
    }


def eflesh_lines(found: dict[str, Any]) -> list[str]:
    """Return the page: a line per row and ridge, the mean absolute error in N by way of reading."""
    runs = "sealed" if found["sealed"] else "development"
    lines = [f"eFlesh, mean absolute error in N; {found['force']}; {runs}"]
    for name, by_ridge in found["mae_N"].items():
        for ridge, by_way in by_ridge.items():
            ways = ", ".join(f"{way} {_in_words(value)}" for way, value in by_way.items())
            lines.append(f"{name:24} ridge {ridge:>5}: {ways}")
    return lines


def _in_words(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.2f}"
    low, high = value["interval_95"]
    return f"{value['mean']:+.2f} [{low:+.2f}, {high:+.2f}]"
