"""The installed package: the sdist makes the wheel, which works in an empty environment; nothing is
downloaded."""

import os
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FIRST_STEPS = """
import sys
from pathlib import Path
import numpy as np
import uniforce_vtla
from uniforce_vtla import ForceHead, Tokenizer
from uniforce_vtla.contracts import MarkerPair
assert Path(uniforce_vtla.__file__).is_relative_to(sys.prefix), uniforce_vtla.__file__
dots = np.kron(np.tile(np.eye(2, dtype=np.uint8), (10, 10)), np.full((24, 32), 255, np.uint8))
pair = MarkerPair(dots, np.roll(dots, 9, axis=1), "right", "tactip")
latent = Tokenizer.from_pretrained().encode(pair)
force_N = ForceHead.from_pretrained("tactip")(latent)
print(tuple(latent.shape), tuple(force_N.shape))
"""


def said(*command, folder):
    """Run a command that knows nothing of the checkout; return what it said."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [*map(str, command)], cwd=folder, env=env, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def build(target, source, out):
    """Build a wheel or sdist with the backend itself: a front end would download it anew."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", target, "-d", out]
    subprocess.run(command, cwd=source, check=True)
    return next(out.glob("*.whl" if target == "wheel" else "*.tar.gz"))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    pytest.importorskip("hatchling", reason="no build backend: make setup brings it")
    folder = tmp_path_factory.mktemp("wheel")
    with tarfile.open(build("sdist", ROOT, folder)) as sdist:
        sdist.extractall(folder / "sdist", filter="data")
    return build("wheel", next((folder / "sdist").iterdir()), folder)


@pytest.mark.timeout(900)
def test_the_wheel_holds_every_file_of_its_packages_and_nothing_else(wheel):
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    wanted = set()
    for package in settings["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]:
        folder = (ROOT / package).parent
        listed = ["git", "ls-files", Path(package).name]
        wanted |= {*subprocess.check_output(listed, cwd=folder, text=True).splitlines()}
    there = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert there == wanted
    names = {Path(name).name for name in there}
    assert {"model.safetensors", "episode_page.js", "model_card.md"} <= names


@pytest.mark.timeout(900)
@pytest.mark.thorough
def test_it_runs_from_an_empty_environment_elsewhere(wheel, tmp_path):
    said(sys.executable, "-m", "venv", "env", folder=tmp_path)
    python = tmp_path / "env" / "bin" / "python"
    install = python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", wheel
    said(*install, folder=tmp_path)
    where = "import sysconfig; print(sysconfig.get_path('purelib'))"
    ours = Path(said(python, "-c", where, folder=tmp_path).strip())
    # the dependencies that are installed already; a .pth in there, as of an editable install, isn't
    # followed from here
    (ours / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    help_text = said(python.parent / "uniforce", "--help", folder=tmp_path)
    assert "uniforce VERB key=value" in help_text and "share" in help_text
    assert said(python, "-c", FIRST_STEPS, folder=tmp_path).endswith("(1, 64, 6) (1, 3)\n")
