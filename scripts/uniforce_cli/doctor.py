"""List what this machine has and lacks for training, recording and rolling out."""

import importlib.metadata
import os
import platform
import resource
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from uniforce_cli.boundary import command
from uniforce_vtla.options import OutFolder

State = Literal["ok", "optional", "missing"]
GB = 1e9
LEAST_FREE_GB = 5.0  # fifty demonstrations, their view and a policy of size tiny
BASE_GPU_GB = 20.0  # `base` in bfloat16 with its activations
NEEDED = ("lerobot", "torch", "mujoco", "av")
EXTRAS = {
    "franky": ("Franka client", "franky-control", 'pip install ".[franka]"; simulation needs none'),
    "dynamixel_sdk": ("GELLO client", "dynamixel-sdk", 'pip install ".[gello]"'),
    "peft": ("LoRA", "peft", 'pip install ".[lora]"'),
    "rerun": ("rerun viewer", "rerun-sdk", 'pip install ".[rerun]"'),
}
REALTIME_KERNEL = Path("/sys/kernel/realtime")
DEVICES = Path("/dev")


@dataclass
class DoctorCommand:
    """List what this machine has, what is missing, and what to do about it.

    Exit code 1: something is missing that everything needs.

    Example: uniforce doctor
    """

    out: OutFolder = "outputs"  # folder for datasets and policies, to see whether it has room


@dataclass(frozen=True)
class Finding:
    """One line of the list."""

    name: str
    state: State
    seen: str
    do: str = ""

    def __str__(self) -> str:
        line = f"{self.state:8}  {self.name:18}  {self.seen}"
        if self.do:
            line += f". {self.do}"
        return line


def packages() -> Iterator[Finding]:
    """Yield Python and the libraries that everything needs."""
    yield Finding("Python", "ok", platform.python_version())
    for name in NEEDED:
        if find_spec(name) is None:
            do = "Run make setup, or pip install this package."
            yield Finding(name, "missing", "not installed", do)
        else:
            yield Finding(name, "ok", importlib.metadata.version(name))


def extras() -> Iterator[Finding]:
    """Yield what single devices or options need."""
    for module, (name, package, do) in EXTRAS.items():
        if find_spec(module) is None:
            yield Finding(name, "optional", "not installed", do)
        else:
            yield Finding(name, "ok", f"{package} {importlib.metadata.version(package)}")


def accelerator() -> Iterator[Finding]:
    """Yield the device that networks run on, and the compiler that speeds them up there."""
    if find_spec("torch") is None:
        return
    import torch

    if not torch.cuda.is_available():
        cores = len(os.sched_getaffinity(0))
        do = "Enough for policies of size tiny. Size base needs a GPU."
        yield Finding("device", "optional", f"CPU with {cores} cores, no CUDA device", do)
        return
    found = torch.cuda.get_device_properties(0)
    memory_GB = found.total_memory / GB
    seen = f"{found.name}, {memory_GB:.0f} GB"
    if memory_GB >= BASE_GPU_GB:
        yield Finding("device", "ok", seen)
    else:
        yield Finding("device", "optional", seen, f"Size base needs about {BASE_GPU_GB:.0f} GB.")
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or find_spec("triton") is None:
        do = "Install gcc and triton, or policies sample without torch.compile."
        yield Finding("compiler", "optional", "no C compiler or no triton", do)
    else:
        yield Finding("compiler", "ok", compiler)


def room(folder: Path) -> Finding:
    """Return how much room there is where data would go."""
    there = _existing(folder)
    free_GB = shutil.disk_usage(there).free / GB
    seen = f"{free_GB:.0f} GB free at {there}"
    if not os.access(there, os.W_OK):
        return Finding("disk", "missing", f"{there} can't be written", "Name another folder: out=…")
    if free_GB < LEAST_FREE_GB:
        do = f"Free {LEAST_FREE_GB:.0f} GB, or name another folder: out=…"
        return Finding("disk", "missing", seen, do)
    return Finding("disk", "ok", seen)


def _existing(folder: Path) -> Path:
    """Return a folder, or the nearest one above it that exists."""
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    return there


def caches() -> Finding:
    """Return whether models and datasets of the hub can be stored."""
    default = Path.home() / ".cache" / "huggingface"
    home = Path(os.environ.get("HF_HOME", default))
    if os.access(_existing(home), os.W_OK):
        return Finding("hub cache", "ok", str(home))
    do = "Set HF_HOME to a folder of yours."
    return Finding("hub cache", "optional", f"{home} can't be written", do)


def realtime() -> Finding:
    """Return whether the kernel can keep the beat of an arm."""
    soft, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    if not REALTIME_KERNEL.exists():
        do = "An arm needs a kernel with PREEMPT_RT; simulation doesn't."
        return Finding("real-time kernel", "optional", f"none ({platform.release()})", do)
    if not soft:
        seen = "there, but this user gets no real-time priority"
        do = "Give your group rtprio in /etc/security/limits.conf."
        return Finding("real-time kernel", "optional", seen, do)
    return Finding("real-time kernel", "ok", f"{platform.release()}, priority up to {soft}")


def devices(name: str, patterns: tuple[str, ...], used_for: str, group: str) -> Finding:
    """Return the devices of one kind, and whether this user may open them."""
    found: list[Path] = []
    for pattern in patterns:
        found += sorted(DEVICES.glob(pattern))
    if not found:
        return Finding(name, "optional", "none", f"Needed for {used_for}.")
    closed = [str(path) for path in found if not os.access(path, os.R_OK | os.W_OK)]
    if closed:
        do = f"Join the group {group}, or write a udev rule."
        return Finding(name, "optional", f"{', '.join(closed)} can't be opened", do)
    return Finding(name, "ok", ", ".join(map(str, found)))


def every_finding(folder: Path) -> Iterator[Finding]:
    """Yield all lines of the list."""
    yield from packages()
    yield from accelerator()
    yield room(folder)
    yield caches()
    yield from extras()
    yield realtime()
    yield devices("cameras", ("video*",), "a GelSight or TacTip, and for scene cameras", "video")
    yield devices("serial ports", ("ttyACM*", "ttyUSB*"), "a uSkin or a GELLO", "dialout")
    yield devices("HID devices", ("hidraw*",), "a SpaceMouse", "plugdev")


@command(DoctorCommand)
def main(config: DoctorCommand) -> int:
    """Print the list."""
    is_missing = False
    for finding in every_finding(Path(config.out)):
        print(finding)
        is_missing = is_missing or finding.state == "missing"
    print("Scenes are drawn in software: no OpenGL is needed.")
    return int(is_missing)
