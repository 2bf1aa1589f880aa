"""Labelled sets on disk: drawing one through the canonicalizer takes minutes, reading it back a second."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.probes.labelled_set import LabelledSet
from uniforce_vtla.array_file import read_arrays

ARRAYS = tuple(f.name for f in fields(LabelledSet) if f.name != "digest")


def cached(
    folder: Path,
    settings: Any,
    sensor: str,
    side: int,
    draw: Callable[[], LabelledSet],
    zoom: tuple[float, float] = (1.0, 1.0),
) -> LabelledSet:
    """Return ``draw()``'s set from ``folder`` if an equal recipe was drawn before, else draw and keep it.

    Only the recipe and the zoom to nominal scale are compared: after a change of the contact model or the
    canonicalizer use another folder.
    """
    zoomed = [] if zoom == (1.0, 1.0) else [zoom]
    recipe = json.dumps([asdict(settings), sensor, side, *zoomed], sort_keys=True)
    name = f"{settings.name}_{sensor}_{hashlib.sha256(recipe.encode()).hexdigest()[:12]}.npz"
    path = folder / name
    if not path.exists():
        drawn = draw()
        folder.mkdir(parents=True, exist_ok=True)
        scratch = path.with_suffix(".tmp.npz")
        np.savez(scratch, digest=np.array(drawn.digest), **{a: getattr(drawn, a) for a in ARRAYS})  # type: ignore
        scratch.replace(path)
    stored = read_arrays(path, (*ARRAYS, "digest"))
    return LabelledSet(**{a: stored[a] for a in ARRAYS}, digest=str(stored["digest"]))
