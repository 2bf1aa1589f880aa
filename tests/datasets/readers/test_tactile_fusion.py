from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

from uniforce_datasets.readers import FusionConfig, FusionKeys, force_set, read_tactile_fusion
from uniforce_vtla import Canonicalizer
from uniforce_vtla.errors import ContractError, DatasetError, SensorError


def recorded(force_N: np.ndarray) -> np.ndarray:
    return (force_N * (1, 1, -1)).astype(np.float32)  # the force sensor's z is negative in compression


@pytest.fixture
def fusion(tmp_path: Path, taxel_run: Any) -> Path:
    """Taxels, and a sensor of unknown form."""
    with h5py.File(tmp_path / "cone.h5", "w") as file:
        file["Xela_uSkin/data"], file["Xela_uSkin/force"] = taxel_run.raw, recorded(taxel_run.force_N)
        file["Tac02/data"], file["Tac02/force"] = (
            np.zeros((6, 20, 16), np.float32),
            recorded(taxel_run.force_N),
        )
    return tmp_path


@pytest.fixture
def with_gels(fusion: Path, gel_run: Any) -> Path:
    with h5py.File(fusion / "cone.h5", "a") as file:
        file["GSMini/images"], file["GSMini/force"] = gel_run.raw, recorded(gel_run.force_N)
        small = cv2.resize(gel_run.raw[0], (16, 12), interpolation=cv2.INTER_AREA)
        smooth = cv2.resize(small, (640, 480), interpolation=cv2.INTER_CUBIC)
        file["9DTact/images"], file["9DTact/force"] = smooth[None], np.zeros((1, 3), np.float32)
    return fusion


def by_hand(sensor: str, run: Any) -> tuple[np.ndarray, np.ndarray]:
    canonicalizer = Canonicalizer(sensor)
    pairs = [canonicalizer.pair(run.raw[0], raw, "left") for raw in run.raw]
    return pairs[0].reference, np.stack([pair.current for pair in pairs])


def check(recording: Any, canonicaliser: str, run: Any) -> None:
    reference, frames = by_hand(canonicaliser, run)
    assert np.array_equal(recording.reference, reference)
    assert np.array_equal(recording.frames, frames)
    assert np.array_equal(recording.force_N, run.force_N)


def test_gel_and_taxels_come_back(with_gels: Path, gel_run: Any, taxel_run: Any) -> None:
    found = force_set(with_gels)
    gel, taxels = found
    assert found.format == "tactile_fusion"
    assert (str(gel), str(taxels)) == ("gsmini/cone/GSMini", "uskin/cone/Xela_uSkin")
    check(gel, "gelsight", gel_run)
    check(taxels, "uskin", taxel_run)
    canonicalizer = Canonicalizer("uskin")
    canonicalizer.set_reference(taxel_run.raw[0])
    assert np.array_equal(taxels.frames[-1], canonicalizer.marker_image(taxel_run.raw[-1]))
    assert (taxels.frames[-1] != taxels.reference).any()


@pytest.mark.parametrize(
    "layout", ["force beside", "trial outside", "trial inside", "bare dataset", "flat counts"]
)
def test_layouts(tmp_path: Path, taxel_run: Any, layout: str) -> None:
    counts, force = taxel_run.raw, recorded(taxel_run.force_N)
    with h5py.File(tmp_path / "cone.h5", "w") as file:
        if layout == "force beside":
            file["uskin/counts"], file["force"] = counts, force
        elif layout == "trial outside":
            for trial in ("t1", "t2"):
                file[f"{trial}/uskin/counts"], file[f"{trial}/wrench"] = counts, np.hstack([force, force])
        elif layout == "trial inside":
            for trial in ("t1", "t2"):
                file[f"xela/{trial}/counts"], file[f"xela/{trial}/ft"] = counts, force
        elif layout == "bare dataset":
            file["uskin"], file["force"] = counts, force
        else:
            file["uskin/counts"], file["uskin/force"] = counts.reshape(-1, 48).astype(np.float64), force
    recordings = list(read_tactile_fusion(tmp_path))
    assert len(recordings) == len({r.trial for r in recordings}) == (2 if layout.startswith("trial") else 1)
    for recording in recordings:
        check(recording, "uskin", taxel_run)


def test_a_stored_reference_goes_before_the_first_frame(fusion: Path, taxel_run: Any) -> None:
    later = slice(2, None)
    with h5py.File(fusion / "cone.h5", "a") as file:
        del file["Xela_uSkin"]
        file["Xela_uSkin/data"], file["Xela_uSkin/force"] = (
            taxel_run.raw[later],
            recorded(taxel_run.force_N[later]),
        )
        file["Xela_uSkin/reference"] = taxel_run.raw[0]
    (recording,) = read_tactile_fusion(fusion, FusionConfig(("uskin",)))
    reference, frames = by_hand("uskin", taxel_run)
    assert np.array_equal(recording.reference, reference) and np.array_equal(recording.frames, frames[later])


def test_a_markerless_gel_raises_the_canonicalisers_error(with_gels: Path) -> None:
    with pytest.raises(SensorError, match="markers on the gel"):
        list(read_tactile_fusion(with_gels, FusionConfig(("9dtact",))))


def test_taxels_of_another_form_are_refused(fusion: Path) -> None:
    with pytest.raises(DatasetError, match=r"\(T, 16, 3\).*\(6, 20, 16\)"):
        list(read_tactile_fusion(fusion, FusionConfig(("tac02",))))


def test_unknown_sensor_is_refused(fusion: Path) -> None:
    with pytest.raises(DatasetError, match=r"gsmini \| 9dtact.*digit"):
        list(read_tactile_fusion(fusion, FusionConfig(("digit",))))


def test_names_can_be_given(with_gels: Path, gel_run: Any) -> None:
    with h5py.File(with_gels / "cone.h5", "a") as file:
        file.move("GSMini", "first_finger")
        file.move("first_finger/images", "first_finger/cam")
    only = FusionConfig(("gsmini",))
    with pytest.raises(DatasetError, match=r"gsmini, got .*first_finger/cam \(6, 480, 640, 3\) uint8"):
        list(read_tactile_fusion(with_gels, only))
    with pytest.raises(DatasetError, match=r"FusionKeys\.signal"):
        list(read_tactile_fusion(with_gels, FusionConfig(("gsmini",), FusionKeys(gsmini=("first_finger",)))))
    keys = FusionKeys(gsmini=("first_finger",), signal=("cam",))
    (recording,) = read_tactile_fusion(with_gels, FusionConfig(("gsmini",), keys))
    check(recording, "gelsight", gel_run)


# -- what can be wrong ----------------------------------------------------------------------------------


def edit(root: Path, name: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    with h5py.File(root / "cone.h5", "a") as file:
        values = file[name][()]
        del file[name]
        file[name] = change(values)


def no_force(root: Path) -> None:
    with h5py.File(root / "cone.h5", "a") as file:
        del file["Xela_uSkin/force"]


def nan(values: np.ndarray) -> np.ndarray:
    values[2, 1] = np.nan
    return values


def truncate(root: Path) -> None:
    path = root / "cone.h5"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def other_file(root: Path) -> Path:
    (root.parent / "other").mkdir(exist_ok=True)
    return root.parent / "other" / f"{root.name}.h5"


def external_link(root: Path) -> None:
    with h5py.File(other_file(root), "w") as other, h5py.File(root / "cone.h5", "a") as file:
        other["counts"] = file["Xela_uSkin/data"][()]
        del file["Xela_uSkin/data"]
        file["Xela_uSkin/data"] = h5py.ExternalLink(str(other_file(root)), "/counts")


def external_group(root: Path) -> None:
    with h5py.File(root / "cone.h5", "a") as file, h5py.File(other_file(root), "w") as other:
        file.copy("Xela_uSkin", other)
        del file["Xela_uSkin"]
        file["Xela_uSkin"] = h5py.ExternalLink(str(other_file(root)), "/Xela_uSkin")


def soft_link(root: Path) -> None:
    with h5py.File(root / "cone.h5", "a") as file:
        file.move("Xela_uSkin/force", "elsewhere")
        file["Xela_uSkin/force"] = h5py.SoftLink("/elsewhere")


def external_storage(root: Path) -> None:
    raw = other_file(root).with_suffix(".bin")
    raw.write_bytes(np.zeros((6, 3), np.float32).tobytes())
    with h5py.File(root / "cone.h5", "a") as file:
        del file["Xela_uSkin/force"]
        file.create_dataset("Xela_uSkin/force", (6, 3), "f4", external=[(str(raw), 0, 72)])


def virtual_dataset(root: Path) -> None:
    with h5py.File(other_file(root), "w") as other:
        other["force"] = np.zeros((6, 3), np.float32)
    layout = h5py.VirtualLayout((6, 3), "f4")
    layout[:] = h5py.VirtualSource(str(other_file(root)), "force", (6, 3))
    with h5py.File(root / "cone.h5", "a") as file:
        del file["Xela_uSkin/force"]
        file.create_virtual_dataset("Xela_uSkin/force", layout)


def text_force(root: Path) -> None:
    with h5py.File(root / "cone.h5", "a") as file:
        del file["Xela_uSkin/force"]
        file["Xela_uSkin/force"] = np.array([["1", "2", "3"]] * 6, dtype="S1")


def linked_file(root: Path) -> None:
    (root / "cone.h5").rename(other_file(root))
    (root / "cone.h5").symlink_to(other_file(root))


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (no_force, r"force of Xela_uSkin.*Xela_uSkin/data \(6, 16, 3\)"),
        (lambda root: edit(root, "Xela_uSkin/force", lambda f: f[:-1]), r"\(6, 3 or more\).*\(5, 3\)"),
        (lambda root: edit(root, "Xela_uSkin/force", lambda f: f[:, :2]), r"\(6, 3 or more\)"),
        (lambda root: edit(root, "Xela_uSkin/force", nan), "NaN or inf in row 2"),
        (lambda root: edit(root, "Xela_uSkin/force", lambda f: f - (0, 0, 1)), "free-air frame"),
        (lambda root: edit(root, "Xela_uSkin/data", lambda c: c + 0.5), "whole counts"),
        (lambda root: edit(root, "Xela_uSkin/data", lambda c: c[:, :4]), r"\(6, 4, 3\)"),
        (text_force, "numbers"),
        (truncate, "a whole h5 file"),
        (external_link, "a link or storage elsewhere"),
        (external_group, "a link or storage elsewhere"),
        (soft_link, "a link or storage elsewhere"),
        (external_storage, "a link or storage elsewhere"),
        (virtual_dataset, "a link or storage elsewhere"),
        (linked_file, "a path inside"),
    ],
)
def test_broken_files_are_refused(fusion: Path, damage: Callable[[Path], Any], says: str) -> None:
    damage(fusion)
    with pytest.raises(DatasetError, match=says):
        list(read_tactile_fusion(fusion, FusionConfig(("uskin",))))


def test_dead_taxels_raise_the_canonicalisers_error(fusion: Path) -> None:
    edit(fusion, "Xela_uSkin/data", np.zeros_like)
    with pytest.raises(SensorError, match="48 zeros"):
        list(read_tactile_fusion(fusion, FusionConfig(("uskin",))))


def test_an_empty_folder_and_an_empty_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"\.h5 or \.hdf5"):
        list(read_tactile_fusion(tmp_path))
    h5py.File(tmp_path / "empty.h5", "w").close()
    with pytest.raises(DatasetError, match="got nothing"):
        list(read_tactile_fusion(tmp_path))


def test_the_missing_package_is_named(fusion: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ContractError, match=r"pip install lerobot_policy_pi05_uniforce\[readers\]"):
        list(read_tactile_fusion(fusion))
