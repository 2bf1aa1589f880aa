"""Data flows one way: a package, and in the library a stage, imports only from those below it."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIBRARY = "uniforce_vtla"
STAGES = {  # the library's folders and what each may import of the others
    "sensors": set(),
    "markers": {"sensors"},
    "contact": {"sensors", "markers"},
    "tokenizer": {"sensors", "markers", "contact"},
    "evaluation": {"markers"},
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
ROOMS = {  # the robot's folders and what each may not import of the others
    "franka": {"teleop", "recorder", "pairs", "standins"},
    "sensors": {"franka", "teleop", "recorder", "pairs", "standins"},
    "teleop": {"recorder", "pairs"},
    "recorder": {"pairs", "standins"},
    "pairs": {"standins"},
}
ROBOT = ROOT / "robots" / ROBOTS
FCI = ROBOT / "standins" / "fci"
# LeRobot imports it to find all the distribution brings
REGISTERS = ROOT / "policies" / POLICIES / "__init__.py"


def forbidden():
    """Yield folders and the packages that none of their modules may import."""
    for package, (folder, may) in PACKAGES.items():
        yield folder, set(PACKAGES) - {package} - may
    for stage, may in STAGES.items():
        yield ROOT / LIBRARY / stage, {f"{LIBRARY}.{name}" for name in {*STAGES} - {stage} - may}
    for room, others in ROOMS.items():
        yield ROBOT / room, {f"{ROBOTS}.{name}" for name in others}
    yield ROOT / LIBRARY, {"lerobot"}
    yield (
        ROBOT / "sensors",
        {f"{LIBRARY}.{name}" for name in ("contact", "tokenizer", "evaluation")},
    )
    yield ROBOT / "franka" / "children", {*PACKAGES, "lerobot"}
    yield FCI, set(PACKAGES) - {ROBOTS} | {"lerobot", "torch"}  # it stands for a device


def modules_of(nodes):
    for node in nodes:
        if isinstance(node, ast.ImportFrom):
            yield node.module or ""
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def foreign_imports(folder, names):
    """Return "file: module" for each import of one of these packages, or of a module in one."""
    return [
        f"{file.relative_to(ROOT)}: {module}"
        for file in folder.rglob("*.py")
        if file != REGISTERS
        for module in modules_of(ast.walk(ast.parse(file.read_text())))
        if any(f"{module}.".startswith(f"{name}.") for name in names)
    ]


def test_every_package_has_its_place():
    packages = [
        file.parent for pattern in ("*", "*/*") for file in ROOT.glob(f"{pattern}/__init__.py")
    ]
    found = {package.relative_to(ROOT) for package in packages}
    inner = {path for path in found if path.parent in found}
    assert {path.name for path in found - inner} == set(PACKAGES)


# sorted: both processes of a run must find the same names
@pytest.mark.parametrize(
    "folder, names", [(folder, sorted(names)) for folder, names in forbidden()], ids=str
)
def test_arrows_point_down(folder, names):
    assert folder.is_dir() and not foreign_imports(folder, names)


def dotted(file, folder):
    """Return a module's name, and a package's for its ``__init__.py``."""
    parts = file.relative_to(folder.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def imported_by(file, modules):
    """Return the project's modules that a file imports, for types too; ``from package import
    module`` is one."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                module = f"{node.module}.{alias.name}"
                found.add(module if module in modules else node.module)
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found & modules


def test_no_modules_import_each_other():
    """Nor in a longer circle, nor for types alone: each can be read after those it imports."""
    files = {}
    for folder, _ in PACKAGES.values():
        files |= {dotted(file, folder): file for file in folder.rglob("*.py")}
    TopologicalSorter(
        {name: imported_by(file, set(files)) for name, file in files.items()}
    ).prepare()


def test_the_arms_stand_in_shares_the_arms_published_numbers_alone():
    for line in foreign_imports(FCI, {ROBOTS}):
        assert f"{ROBOTS}.standins." in line or line.endswith(f"{ROBOTS}.fr3"), line


def test_the_vendors_client_is_loaded_where_it_is_needed_only():
    """It is no core dependency: no module imports it at its top."""
    for file in (ROBOT / "franka").rglob("*.py"):
        assert "franky" not in modules_of(ast.parse(file.read_text()).body), file


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
