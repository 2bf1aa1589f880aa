"""Data flows one way: a package, and in the library a stage, imports only from those below it."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIBRARY = "uniforce_vtla"
STAGES = {  # the library's folders and what each may import of the others
    "sensors": set(),
    "markers": {"sensors"},
    "contact": {"sensors", "markers"},
    "tokenizer": {"sensors", "markers", "contact"},
    "evaluation": set(),
}
ENVS, DATASETS, ROBOTS = "lerobot_env_uniforce_wiping", "uniforce_datasets", "uniforce_robots"
POLICIES, COMMAND, BENCHMARKS = "lerobot_policy_pi05_uniforce", "uniforce_cli", "benchmarks"
PACKAGES = {  # folder, and the packages it may import
    LIBRARY: (ROOT / LIBRARY, set()),
    ENVS: (ROOT / "envs" / ENVS, {LIBRARY}),
    DATASETS: (ROOT / "datasets" / DATASETS, {LIBRARY}),
    POLICIES: (ROOT / "policies" / POLICIES, {LIBRARY}),
    ROBOTS: (ROOT / "robots" / ROBOTS, {LIBRARY, ENVS, DATASETS}),
    COMMAND: (ROOT / "scripts" / COMMAND, {LIBRARY, ENVS, DATASETS, POLICIES, ROBOTS}),
    BENCHMARKS: (ROOT / BENCHMARKS, {LIBRARY, ENVS, DATASETS, POLICIES, ROBOTS, COMMAND}),
}
# LeRobot imports it to find all the distribution brings
REGISTERS = ROOT / "policies" / POLICIES / "__init__.py"


def modules_of(file):
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom):
            yield node.module or ""
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def foreign_imports(folder, forbidden):
    """Return "file: module" for each import of a package, or of a module in one, that is forbidden."""
    return [
        f"{file.relative_to(ROOT)}: {module}"
        for file in folder.rglob("*.py")
        if file != REGISTERS
        for module in modules_of(file)
        if any(module == name or module.startswith(f"{name}.") for name in forbidden)
    ]


def test_every_package_has_its_place():
    packages = [
        file.parent for pattern in ("*", "*/*") for file in ROOT.glob(f"{pattern}/__init__.py")
    ]
    found = {package.relative_to(ROOT) for package in packages}
    inner = {path for path in found if path.parent in found}
    assert {path.name for path in found - inner} == set(PACKAGES)


@pytest.mark.parametrize("package", PACKAGES)
def test_arrows_point_down(package):
    folder, may = PACKAGES[package]
    assert not foreign_imports(folder, set(PACKAGES) - {package} - may)


@pytest.mark.parametrize("stage", STAGES)
def test_stage_imports_only_from_its_left(stage):
    others = {f"{LIBRARY}.{name}" for name in set(STAGES) - {stage} - STAGES[stage]}
    assert not foreign_imports(ROOT / LIBRARY / stage, others)


def test_the_library_knows_no_lerobot():
    assert not foreign_imports(ROOT / LIBRARY, {"lerobot"})


def test_the_arms_stand_in_knows_nothing_of_the_project():
    """It stands for a device, shares the arm's published numbers alone, and starts without torch."""
    standins = f"{ROBOTS}.standins.fci"
    ours = {m for m in PACKAGES if m != ROBOTS} | {"lerobot", "torch"}
    folder = ROOT / "robots" / ROBOTS / "standins" / "fci"
    assert not foreign_imports(folder, ours)
    robots = [line for line in foreign_imports(folder, {ROBOTS}) if standins not in line]
    assert all(
        f"{ROBOTS}.standins." in line or line.endswith(f"{ROBOTS}.fr3") for line in robots
    ), robots


def test_the_arms_children_import_nothing_of_ours():
    assert not foreign_imports(
        ROOT / "robots" / ROBOTS / "franka" / "children", {*PACKAGES, "lerobot"}
    )


@pytest.mark.parametrize(
    "room, forbidden",
    [
        ("franka", {"teleop", "recorder", "pairs", "standins"}),
        ("sensors", {"franka", "teleop", "recorder", "pairs", "standins"}),
        ("teleop", {"recorder", "pairs"}),
        ("recorder", {"pairs", "standins"}),
        ("pairs", {"standins"}),
    ],
)
def test_rooms_of_the_robot_stay_apart(room, forbidden):
    folder = ROOT / "robots" / ROBOTS / room
    assert not foreign_imports(folder, {f"{ROBOTS}.{name}" for name in forbidden})


def test_devices_know_sensors_and_markers_only():
    others = {f"{LIBRARY}.{name}" for name in ("contact", "tokenizer", "evaluation")}
    assert not foreign_imports(ROOT / "robots" / ROBOTS / "sensors", others)


def test_the_vendors_client_is_loaded_where_it_is_needed_only():
    """It is no core dependency: no module imports it at its top."""
    for file in (ROOT / "robots" / ROBOTS / "franka").rglob("*.py"):
        top = ast.parse(file.read_text()).body
        names = [alias.name for node in top if isinstance(node, ast.Import) for alias in node.names]
        names += [node.module or "" for node in top if isinstance(node, ast.ImportFrom)]
        assert "franky" not in names, f"{file.relative_to(ROOT)} imports a client"


def test_no_folder_shadows_the_datasets_library():
    assert not (ROOT / "datasets" / "__init__.py").exists()
    import lerobot.datasets

    import datasets

    assert "site-packages" in str(datasets.__file__) and lerobot.datasets


def test_a_command_of_the_benchmarks_does_its_work_when_it_is_run():
    """``python -m`` of a file that only defines its command ends with 0 and has done nothing."""
    texts = {file: file.read_text() for file in (ROOT / BENCHMARKS).rglob("*.py")}
    commands = {
        str(file.relative_to(ROOT)): text for file, text in texts.items() if "@command(" in text
    }
    assert commands and not [
        name for name, text in commands.items() if '__name__ == "__main__"' not in text
    ]
