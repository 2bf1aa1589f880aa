"""Data flows one way: a stage imports only from stages to its left."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SHARED = {
    "contracts",
    "errors",
    "keys",
    "results_file",
    "figure_file",
    "json_file",
    "file_hashes",
    "array_file",
    "arguments",
    "options",
}
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


def test_nothing_left_of_the_seam_knows_policies_environments_or_robots() -> None:
    others = {p.parent.name for p in ROOT.glob("*/*/__init__.py")} - set(MAY_IMPORT)
    assert {"lerobot_policy_pi05_uniforce", "lerobot_env_uniforce_wiping", "uniforce_commands"} < others
    assert not foreign_imports(ROOT / "uniforce_vtla", ("lerobot", *others))


def foreign_imports(folder: Path, forbidden: tuple[str, ...]) -> list[str]:
    found = []
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            found += [f"{file.relative_to(ROOT)}: {m}" for m in modules if m.split(".")[0] in forbidden]
    return found


def test_nothing_but_scripts_and_trials_of_whole_sessions_knows_the_commands() -> None:
    may = ("commands", "scripts", "tests", "benchmarks", "uniforce_recorder_trials")
    for folder in {p.parent for p in ROOT.glob("*/*/__init__.py")}:
        if folder.parent.name not in may and folder.name not in may:
            assert not foreign_imports(folder, ("uniforce_commands",)), f"{folder.name} imports a command"


def test_the_arms_stand_in_knows_nothing_of_the_project() -> None:
    """It stands for a device, and starts without torch; tactile ones show what the contact simulator says."""
    ours = (
        "uniforce_vtla",
        "lerobot",
        "lerobot_robot_uniforce_franka",
        "lerobot_env_uniforce_wiping",
        "torch",
    )
    assert not foreign_imports(ROOT / "standins" / "uniforce_standins" / "fci", ours)


def test_the_robot_knows_no_policy_and_its_children_not_even_the_robot() -> None:
    robot = ROOT / "robots" / "lerobot_robot_uniforce_franka"
    assert not foreign_imports(
        robot, ("lerobot_policy_pi05_uniforce", "lerobot_env_uniforce_wiping", "uniforce_standins")
    )
    assert not foreign_imports(
        robot / "children", ("uniforce_vtla", "lerobot", "lerobot_robot_uniforce_franka")
    )


def test_recording_knows_no_policy_and_no_stand_in() -> None:
    forbidden = ("lerobot_policy_pi05_uniforce", "uniforce_standins", "uniforce_recorder_trials")
    assert not foreign_imports(ROOT / "recording" / "uniforce_recording", forbidden)
    for folder in ("robots", "devices", "datasets", "envs", "policies"):
        assert not foreign_imports(ROOT / folder, ("uniforce_recording",)), f"{folder} imports the recorder"


def test_vendors_clients_are_loaded_where_they_are_needed_only() -> None:
    """Both in one process fail, and neither is a core dependency: no module imports one at its top."""
    robot = ROOT / "robots" / "lerobot_robot_uniforce_franka"
    for file in robot.rglob("*.py"):
        top = ast.parse(file.read_text()).body
        names = [alias.name for node in top if isinstance(node, ast.Import) for alias in node.names]
        names += [node.module or "" for node in top if isinstance(node, ast.ImportFrom)]
        assert not {"franky", "pylibfranka"} & set(names), f"{file.relative_to(ROOT)} imports a client"


def test_devices_know_sensors_and_markers_only() -> None:
    allowed = SHARED | {"sensors", "markers"}
    for file in (ROOT / "devices" / "lerobot_camera_uniforce").rglob("*.py"):
        foreign = imported_stages(file) - allowed
        assert not foreign, f"{file.relative_to(ROOT)} imports {foreign}"
        assert "uniforce_standins" not in file.read_text(), (
            f"{file.name}: drivers must not know their stand-ins"
        )


def test_teleoperators_know_no_policy_and_of_stand_ins_the_published_kinematics_only() -> None:
    teleoperators = ROOT / "teleoperators" / "lerobot_teleoperator_uniforce"
    assert not foreign_imports(teleoperators, ("lerobot_policy_pi05_uniforce", "uniforce_datasets"))
    for file in teleoperators.rglob("*.py"):
        others = [line for line in file.read_text().splitlines() if "uniforce_standins" in line]
        assert all("fci.kinematics" in line for line in others), f"{file.name}: {others}"


def test_what_scores_pairs_never_sees_the_truth() -> None:
    recording = ROOT / "recording" / "uniforce_pair_recording"
    for file in recording.glob("*.py"):
        if file.name not in ("rehearsal.py", "guided_grasp.py"):
            text = file.read_text()
            assert "rehearsal" not in text and "truths" not in text, f"{file.name} knows the truth"


def test_no_folder_shadows_the_datasets_library() -> None:
    assert not (ROOT / "datasets" / "__init__.py").exists()
    import lerobot.datasets

    import datasets

    assert "site-packages" in str(datasets.__file__) and lerobot.datasets
