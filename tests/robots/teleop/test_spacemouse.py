"""SpaceMouse: reports, the drained device, and how it fails."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from standins.spacemouse import reports

import uniforce_robots.teleop as ours
from uniforce_robots.standins.process import StandIn
from uniforce_robots.teleop.spacemouse import LARGEST_COUNT, SpaceMouseSource, find_spacemice
from uniforce_vtla.errors import TeleoperatorError

counts = st.tuples(*[st.integers(-350, 350)] * 6)


@given(counts, st.integers(0, 3), st.sampled_from(["three", "six"]))
def test_both_layouts_say_the_same(axes: tuple, buttons: int, layout: str) -> None:
    reader = SpaceMouseSource()
    assert all(reader.feed(report) for report in reports(axes, buttons, layout))
    assert reader.state.tolist() == [*axes, buttons & 1, buttons >> 1]


@examples(300)
@given(st.lists(st.binary(max_size=64), max_size=20))
def test_any_bytes_leave_a_possible_state(chunks: list) -> None:
    reader = SpaceMouseSource()
    for chunk in chunks:
        reader.feed(chunk)
    state = reader.state
    assert np.all(np.abs(state[:6]) <= LARGEST_COUNT) and set(state[6:]) <= {0.0, 1.0}
    assert reader.counts.samples + reader.counts.bad == len(chunks)


@pytest.fixture
def mouse(connected: Callable[[str], Any], measured: np.ndarray) -> Any:
    device = connected("uniforce_spacemouse")
    device.start_from(measured)
    return device


def test_a_push_moves_and_letting_go_stops(
    mouse: Any, spacemouse: StandIn, measured: np.ndarray, until: Callable[..., Any]
) -> None:
    spacemouse.inject("push")  # pushed away from the person: forward, +x
    until(lambda: mouse.get_action()["x.pos"], lambda x: x > measured[0] + 0.01)
    spacemouse.inject("none")
    until(mouse.rates, lambda rates: not rates.any())
    here = mouse.get_action()
    time.sleep(0.05)
    assert mouse.get_action() == here
    assert here["y.pos"] == measured[1] and here["yaw.pos"] == measured[3]


def test_the_left_button_closes(mouse: Any, spacemouse: StandIn, measured: np.ndarray, until: Callable):
    spacemouse.inject("close")
    until(lambda: mouse.get_action()["width.pos"], lambda width: width < measured[4] - 0.005)


def test_a_queue_is_drained_before_it_is_followed(mouse: Any, spacemouse: StandIn, until: Callable) -> None:
    """Forty reports per beat and no question: once the cap is let go, the very next answer is rest."""
    spacemouse.inject("burst")
    time.sleep(0.5)
    spacemouse.inject("none")
    until(mouse.rates, lambda rates: not rates.any(), timeout_s=5.0)
    assert mouse.device.counts.samples > 500


def test_a_deflected_cap_that_falls_silent_is_stale(
    mouse: Any, spacemouse: StandIn, until: Callable[..., Any], fault_of: Callable[..., str]
) -> None:
    spacemouse.inject("push")
    until(mouse.rates, lambda rates: rates.any())
    spacemouse.inject("freeze")
    assert fault_of(mouse.get_action) == "stale"


def test_no_start_with_a_deflected_cap(
    mouse: Any, spacemouse: StandIn, measured: np.ndarray, fault_of: Callable[..., str]
) -> None:
    spacemouse.inject("push")
    assert fault_of(lambda: mouse.start_from(measured)) == "far"


def test_no_device_says_what_to_do(tmp_path: Path) -> None:
    device = ours.UniforceSpaceMouse(
        ours.UniforceSpaceMouseConfig(device=str(tmp_path / "none"), calibration_dir=tmp_path)
    )
    with pytest.raises(TeleoperatorError, match="udev") as error:
        device.connect()
    assert error.value.fault == "connection" and not device.is_connected


def test_spacemice_are_found_by_their_ids(tmp_path: Path) -> None:
    for number, hid in enumerate(("0000256F:0000C635", "0000046D:0000C626", "0000046D:0000C52B")):
        device = tmp_path / f"hidraw{number}" / "device"
        device.mkdir(parents=True)
        (device / "uevent").write_text(f"DRIVER=hid\nHID_ID=0003:{hid}\n")
    (tmp_path / "hidraw3").mkdir()
    assert find_spacemice(tmp_path) == ["/dev/hidraw0", "/dev/hidraw1"]
    assert find_spacemice(tmp_path / "nothing") == []
