"""Data flows one way: a stage imports only from stages to its left."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SHARED = {"contracts", "errors", "keys", "results_file"}
MAY_IMPORT = {
    "sensors": set(),
    "markers": {"sensors"},
    "contact": {"sensors", "markers"},
    "tokenizer": {"sensors", "markers", "contact"},
    "probes": {"sensors", "markers", "contact", "tokenizer"},
    "peers": {"sensors", "markers", "contact", "tokenizer", "probes"},
    "evaluation": set(),
}


def imported_stages(file: Path) -> set[str]:
    modules: list[str] = []
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            modules.append(node.module)
        elif isinstance(node, ast.Import):
            modules += [alias.name for alias in node.names]
    return {m.split(".")[1] for m in modules if m.startswith("uniforce_vtla.")}


@pytest.mark.parametrize("stage", MAY_IMPORT)
def test_stage_imports_only_from_its_left(stage: str) -> None:
    for file in (ROOT / "uniforce_vtla" / stage).rglob("*.py"):
        foreign = imported_stages(file) - SHARED - {stage} - MAY_IMPORT[stage]
        assert not foreign, f"{file.relative_to(ROOT)} imports {foreign}"


@pytest.mark.parametrize(
    "package", ["sensors", "markers", "contact", "tokenizer", "probes", "peers", "evaluation"]
)
def test_nothing_left_of_the_seam_knows_policies_or_environments(package: str) -> None:
    forbidden = (
        "lerobot",
        "lerobot_policy_pi05_uniforce",
        "lerobot_env_uniforce_wiping",
        "uniforce_datasets",
        "uniforce_standins",
    )
    for file in (ROOT / "uniforce_vtla" / package).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            module = node.module if isinstance(node, ast.ImportFrom) else None
            assert not (module or "").startswith(forbidden), f"{file.relative_to(ROOT)} imports {module}"


def test_devices_know_sensors_and_markers_only() -> None:
    allowed = SHARED | {"sensors", "markers"}
    for file in (ROOT / "devices" / "lerobot_camera_uniforce").rglob("*.py"):
        foreign = imported_stages(file) - allowed
        assert not foreign, f"{file.relative_to(ROOT)} imports {foreign}"
        assert "uniforce_standins" not in file.read_text(), (
            f"{file.name}: drivers must not know their stand-ins"
        )


def test_no_folder_shadows_the_datasets_library() -> None:
    assert not (ROOT / "datasets" / "__init__.py").exists()
    import lerobot.datasets

    import datasets

    assert "site-packages" in str(datasets.__file__) and lerobot.datasets
