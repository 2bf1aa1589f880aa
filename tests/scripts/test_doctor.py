"""``uniforce doctor`` names what is there and what is missing, and fails only where everything
would."""

from types import SimpleNamespace

import pytest

from uniforce_cli import doctor


def test_a_whole_machine_passes(tmp_path, capsys):
    assert doctor.main([f"out={tmp_path}"]) == 0
    said = capsys.readouterr().out
    named = "Python, torch, device, disk, hub cache, real-time kernel, cameras, serial ports"
    for name in named.split(", "):
        assert name in said
    assert "missing" not in said


def test_a_missing_library_fails_and_says_what_to_do(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(doctor, "NEEDED", ("torch", "no_such_library"))
    assert doctor.main([f"out={tmp_path}"]) == 1
    line = next(line for line in capsys.readouterr().out.splitlines() if "no_such_library" in line)
    assert line.startswith("missing") and "make setup" in line


def test_a_full_disk_fails(monkeypatch, tmp_path):
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda path: SimpleNamespace(free=1e9))
    found = doctor.room(tmp_path / "not" / "yet" / "there")
    assert found.state == "missing" and "1 GB free" in found.seen and "Free 5 GB" in found.do


def test_devices_are_listed_and_closed_ones_say_how_to_open_them(monkeypatch, tmp_path):
    monkeypatch.setattr(doctor, "DEVICES", tmp_path)
    wanted = "cameras", ("video*",), "a GelSight", "video"
    assert doctor.devices(*wanted).state == "optional"
    (tmp_path / "video0").touch()
    assert doctor.devices(*wanted).seen == str(tmp_path / "video0")
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: False)
    closed = doctor.devices(*wanted)
    assert closed.state == "optional" and "group video" in closed.do


@pytest.mark.parametrize(
    "kernel, priority, seen, state",
    [("none", 0, "none", "optional"), ("", 0, "no real-time", "optional"), ("", 99, "99", "ok")],
)
def test_a_realtime_kernel_needs_priority_too(monkeypatch, tmp_path, kernel, priority, seen, state):
    monkeypatch.setattr(doctor, "REALTIME_KERNEL", tmp_path / kernel)
    monkeypatch.setattr(doctor.resource, "getrlimit", lambda kind: (priority, priority))
    found = doctor.realtime()
    assert seen in found.seen and found.state == state
