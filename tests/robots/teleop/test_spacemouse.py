"""SpaceMouse: reports, the drained device, and how it fails."""

import itertools
import os
import socket
import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from robot_fakes import refused
from standins.spacemouse import reports

import uniforce_robots.teleop as ours
from uniforce_robots.sensors.faults import LostSensorError, WrongSensorError
from uniforce_robots.teleop import spacemouse as spacemouse_module
from uniforce_robots.teleop.spacemouse import (
    LARGEST_COUNT,
    SILENT_S,
    SpaceMouseSource,
    UniforceSpaceMouse,
    UniforceSpaceMouseConfig,
    find_spacemice,
)
from uniforce_vtla.errors import TeleoperatorError

counts = st.tuples(*[st.integers(-350, 350)] * 6)


@given(counts, st.integers(0, 3), st.sampled_from(["three", "six"]))
def test_both_layouts_say_the_same(axes, buttons, layout):
    reader = SpaceMouseSource()
    assert all(reader.feed(report) for report in reports(axes, buttons, layout))
    assert reader.state.tolist() == [*axes, buttons & 1, buttons >> 1]


@examples(300)
@given(st.lists(st.binary(max_size=64), max_size=20))
def test_any_bytes_leave_a_possible_state(chunks):
    reader = SpaceMouseSource()
    for chunk in chunks:
        reader.feed(chunk)
    state = reader.state
    assert np.all(np.abs(state[:6]) <= LARGEST_COUNT) and set(state[6:]) <= {0.0, 1.0}
    assert reader.counts.samples + reader.counts.bad == len(chunks)


@pytest.fixture
def mouse(started):
    return started("uniforce_spacemouse")


def test_a_push_moves_and_letting_go_stops(mouse, spacemouse, measured, until):
    spacemouse.inject("push")  # pushed away from the person: forward, +x
    until(lambda: mouse.get_action()["x.pos"], lambda x: x > measured[0] + 0.01)
    spacemouse.inject("none")
    until(mouse.rates, lambda rates: not rates.any())
    here = mouse.get_action()
    time.sleep(0.05)
    assert mouse.get_action() == here
    assert here["y.pos"] == measured[1] and here["yaw.pos"] == measured[3]


def test_the_left_button_closes(mouse, spacemouse, measured, until):
    spacemouse.inject("close")
    until(lambda: mouse.get_action()["width.pos"], lambda width: width < measured[4] - 0.005)


def test_a_queue_is_drained_before_it_is_followed(mouse, spacemouse, until):
    """Forty reports per beat, no question: once the cap is let go, the next answer is rest."""
    spacemouse.inject("burst")
    time.sleep(0.5)
    spacemouse.inject("none")
    until(mouse.rates, lambda rates: not rates.any(), timeout_s=5.0)
    assert mouse.device.counts.samples > 500


def test_a_deflected_cap_that_falls_silent_is_stale(mouse, spacemouse, until, fault_of):
    spacemouse.inject("push")
    until(mouse.rates, lambda rates: rates.any())
    spacemouse.inject("freeze")
    assert fault_of(mouse.get_action) == "stale"


def test_no_start_with_a_deflected_cap(mouse, spacemouse, measured, fault_of):
    spacemouse.inject("push")
    assert fault_of(lambda: mouse.start_from(measured)) == "far"


def test_two_buttons_that_cancel_each_other_are_not_at_rest(measured, fault_of):
    """Letting go of one of them would move the fingers, and that is no new wish."""
    pressed = SimpleNamespace(raw=np.array([0.0] * 6 + [1.0, 1.0]), age_ms=0.0)
    mouse = UniforceSpaceMouse(UniforceSpaceMouseConfig())
    mouse.device = SimpleNamespace(newest=lambda age_ms: pressed, is_running=True, reconnects=0)
    assert fault_of(lambda: mouse.start_from(measured)) == "far"


def test_a_plug_that_comes_back_with_a_pushed_cap_starts_nothing(
    mouse, spacemouse, measured, starts, fault_of
):
    spacemouse.inject("unplug")
    assert fault_of(mouse.get_action) == "connection"
    spacemouse.inject("push")
    for _ in range(100):
        with pytest.raises(TeleoperatorError):
            mouse.start_from(measured)
        time.sleep(0.005)
    assert fault_of(lambda: mouse.start_from(measured)) == "far"
    spacemouse.inject("none")
    starts(mouse)
    assert mouse.get_action()["x.pos"] == measured[0]


@pytest.fixture
def nodes(tmp_path, monkeypatch):
    """Return a function: facts of each hidraw node → its far end, in a temporary kernel folder."""
    ends = {}
    monkeypatch.setattr(spacemouse_module, "SYS_HIDRAW", tmp_path)
    monkeypatch.setattr(find_spacemice, "__defaults__", (tmp_path,))
    monkeypatch.setattr(spacemouse_module, "_open", lambda path: os.dup(ends[path][0].fileno()))
    monkeypatch.setattr(spacemouse_module, "MOVE_S", 0.2)

    def make(*facts, descriptor=b""):
        for number, lines in enumerate(facts):
            device = tmp_path / f"hidraw{number}" / "device"
            device.mkdir(parents=True)
            (device / "uevent").write_text(lines)
            if descriptor:
                (device / "report_descriptor").write_bytes(descriptor)
            ends[f"/dev/hidraw{number}"] = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        return [far for _, far in ends.values()]

    yield make
    for end in itertools.chain.from_iterable(ends.values()):
        end.close()


MOUSE = "HID_ID=0003:0000256F:0000C635\nHID_NAME=SpaceMouse\n"
KEYBOARD = "HID_ID=0003:0000046D:0000C31C\nHID_NAME=K120\n"


def read_some(source):
    samples = []
    deadline_s = time.monotonic() + 5
    while not samples and time.monotonic() < deadline_s:
        samples += source.read()
    return [sample.raw.tolist() for sample in samples]


def test_rest_is_silence_and_half_a_state_is_none(nodes):
    (device,) = nodes(MOUSE)
    source = SpaceMouseSource()
    source.open()
    begun_s = time.monotonic()
    assert read_some(source) == [[0.0] * 8] and time.monotonic() - begun_s > SILENT_S
    source.open()
    first, second, _ = reports((1, 2, 3, 4, 5, 6), 0)
    device.send(first)
    assert source.read() == []
    device.send(second)
    assert read_some(source) == [[1, 2, 3, 4, 5, 6, 0, 0]]
    source.close()


def test_of_a_receivers_nodes_the_one_that_moves_is_read_then_and_later(nodes, monkeypatch):
    receiver = "HID_ID=0003:0000256F:0000C652\nHID_NAME=Universal Receiver\nHID_PHYS=usb-3/input"
    ends = nodes(*[f"{receiver}{n}\n" for n in range(3)])
    source = SpaceMouseSource()
    with pytest.raises(LostSensorError, match=r"Universal Receiver, usb-3/input2"):
        source.open()
    ends[0].close()
    ends[1].send(reports((5, 0, 0, 0, 0, 0), 0, "six")[0])
    source.open()
    source.open()  # plugged in again: nobody is asked to move it
    ends[1].send(reports((0,) * 6, 0, "six")[0])
    assert read_some(source) == [[0.0] * 8]
    source.close()


@pytest.mark.parametrize(
    "facts, descriptor, is_one",
    [
        (MOUSE, b"", True),
        ("HID_ID=0003:0000046D:0000C626\nHID_NAME=SpaceNavigator\n", b"", True),
        (KEYBOARD, b"", False),
        (KEYBOARD, b"\x05\x01\x09\x08", True),  # of another maker, but that is what it is
        (MOUSE, b"\x05\x01\x09\x06", False),  # a keyboard of the same maker
    ],
)
def test_a_spacemouse_is_what_the_kernel_says_it_is(facts, descriptor, is_one, nodes, tmp_path):
    nodes(facts, descriptor=descriptor)
    (tmp_path / "hidraw1").mkdir()  # says nothing of itself
    assert find_spacemice() == ["/dev/hidraw0"] * is_one
    assert find_spacemice(tmp_path / "nothing") == []
    link = tmp_path / "linked"
    link.symlink_to("/dev/hidraw0")
    for named in () if is_one else ("/dev/hidraw0", str(link)):
        with pytest.raises(WrongSensorError, match=facts.split("=")[-1].strip()):
            SpaceMouseSource(named).open()


def test_no_device_says_what_to_do(tmp_path):
    device = ours.UniforceSpaceMouse(
        ours.UniforceSpaceMouseConfig(device=str(tmp_path / "none"), calibration_dir=tmp_path)
    )
    with refused("connection", TeleoperatorError, "udev"):
        device.connect()
    assert not device.is_connected
