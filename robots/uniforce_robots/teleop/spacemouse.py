"""Steer with a SpaceMouse: deflection is speed, the buttons close and open the fingers. Never run on hardware.

Not pyspacemouse or hidapi: they open nothing but a real HID node, so none of the fault tests can run on them
(pyspacemouse also needs easyhid, which has no wheel).
"""

from __future__ import annotations

import os
import select
import socket
import stat
import struct
from pathlib import Path

import numpy as np

from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.reader import ReaderLimits, SampleReader
from uniforce_robots.sensors.samples import SourceCounts, Stamped, now_ns
from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.configs import UniforceSpaceMouseConfig
from uniforce_vtla.errors import TeleoperatorError, expected

SYS_HIDRAW = Path("/sys/class/hidraw")
# Vendor and product as the kernel writes them: Logitech's SpaceNavigator, 3Dconnexion's family.
VENDORS = {"0000046D": {"0000C626", "0000C627", "0000C628", "0000C629", "0000C62B"}, "0000256F": None}
REPORT_BYTES = 64
READ_TIMEOUT_S = 0.05
BAD_IN_A_ROW = 20  # a third of a second of nothing but nonsense
DO_PLUG = "Plug it in; give yourself read permission on /dev/hidraw* by a udev rule."
FOREVER_MS = 1e12  # a cap at rest is silent until it is touched
SILENT_S = (
    0.25  # a deflected cap that sends nothing for so long is a dead one; wireless ones send at some 60 Hz
)
# A cap at rest sends nothing, and one held still the same: neither silence nor repetition is a fault of the device.
LIMITS = ReaderLimits(capacity=64, frozen_after=0, silent_s=float("inf"))
AXES, BUTTONS = 6, 2  # more buttons exist on some models and mean nothing here
TURN_ABOUT_Z = 5
FULL_SCALE = 350.0  # counts at full deflection
LARGEST_COUNT = 2000  # beyond this it is no deflection
_THREE, _SIX = struct.Struct("<3h"), struct.Struct("<6h")


class SpaceMouseReports:
    """HID reports → a state (8,) float64: x, y, z, turns about x, y, z in counts, left and right button; no I/O.

    Two layouts are in use. Older: report 1 = x, y, z and report 2 = turns about them, int16 little endian. Newer: all
    six in report 1. Report 3 = buttons, one bit each. The device's own axes: x right, y towards the person, z down.
    """

    def __init__(self) -> None:
        self._state = np.zeros(AXES + BUTTONS)
        self._samples = self._bad = 0

    @property
    def counts(self) -> SourceCounts:
        """Reports understood and not."""
        return SourceCounts(self._samples, 0, self._bad)

    @property
    def state(self) -> np.ndarray:
        """(8,) the newest state, a copy."""
        return self._state.copy()

    def forget(self) -> None:
        """Go back to rest, as a device does that is plugged in anew."""
        self._state[:] = 0

    def feed(self, report: bytes) -> bool:
        """Take one report, its id in the first byte; return whether it was understood."""
        understood = self._take(report[0], report[1:]) if report else False
        self._samples += understood
        self._bad += not understood
        return understood

    def _take(self, report_id: int, body: bytes) -> bool:
        if report_id == 1 and len(body) >= _SIX.size:
            return self._put(0, _SIX.unpack_from(body))
        if report_id in (1, 2) and _THREE.size <= len(body) < _SIX.size:
            return self._put(3 * (report_id - 1), _THREE.unpack_from(body))
        if report_id == 3 and body:
            self._state[AXES:] = [(body[0] >> bit) & 1 for bit in range(BUTTONS)]
            return True
        return report_id > 3 and bool(body)  # battery level, calibration, LEDs: known to exist, not needed

    def _put(self, first: int, values: tuple[int, ...]) -> bool:
        if max(map(abs, values)) > LARGEST_COUNT:
            return False
        self._state[first : first + len(values)] = values
        return True


def find_spacemice(folder: Path = SYS_HIDRAW) -> list[str]:
    """Return the /dev/hidrawN of every SpaceMouse the kernel knows."""
    devices = sorted(folder.iterdir()) if folder.is_dir() else []
    return [f"/dev/{device.name}" for device in devices if _is_spacemouse(device / "device" / "uevent")]


def _is_spacemouse(uevent: Path) -> bool:
    text = uevent.read_text(errors="replace") if uevent.is_file() else ""
    lines = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)
    _, _, ids = lines.get("HID_ID", "").upper().partition(":")
    vendor, _, product = ids.partition(":")
    known = VENDORS.get(vendor, set())
    return known is None or product in known


class SpaceMouseSource:
    """A ``SampleSource`` of states (8,); see ``SpaceMouseReports``.

    A thread drains it: reading slower than the device sends would leave a queue in the kernel, and the robot would
    move on for a second after the cap was let go.

    Args:
        device: /dev/hidrawN or a local packet socket; empty for the only SpaceMouse there is.
    """

    def __init__(self, device: str = "") -> None:
        self.name = f"spacemouse ({device or 'any'})"
        self._device = device
        self._reports = SpaceMouseReports()
        self._fd = -1
        self._rest_sent = False
        self._bad_in_a_row = 0

    @property
    def counts(self) -> SourceCounts:
        """Reports understood and not."""
        return self._reports.counts

    def open(self) -> None:
        """Open the device; raises LostSensorError where there is none, several, or no permission."""
        found = [self._device] if self._device else find_spacemice()
        if len(found) != 1:
            do = DO_PLUG if not found else "Name one: device=/dev/hidrawN."
            raise LostSensorError(expected(self.name, "one SpaceMouse", found or "none", do))
        try:
            self._fd = _open(found[0])
        except OSError as error:
            raise LostSensorError(expected(self.name, "a device to read", error, DO_PLUG)) from error
        self._reports.forget()
        self._rest_sent, self._bad_in_a_row = False, 0

    def read(self) -> list[Stamped]:
        """Return the newest state if anything came; at first the state of rest, since a cap at rest is silent.

        Raises:
            LostSensorError: it was unplugged.
            ProtocolError: it sends nothing a SpaceMouse would.
        """
        if not self._rest_sent:
            self._rest_sent = True
            return [Stamped(now_ns(), self._reports.state)]
        readable, _, _ = select.select([self._fd], [], [], READ_TIMEOUT_S)
        if not readable:
            return []
        understood = self._reports.feed(self._one_report())
        self._bad_in_a_row = 0 if understood else self._bad_in_a_row + 1
        if self._bad_in_a_row >= BAD_IN_A_ROW:
            came = f"{BAD_IN_A_ROW} unknown ones in a row"
            do = "Is this the right hidraw device?"
            raise ProtocolError(expected(self.name, "reports of a SpaceMouse", came, do))
        return [Stamped(now_ns(), self._reports.state)] if understood else []

    def close(self) -> None:
        """Let go of it."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def _one_report(self) -> bytes:
        try:
            report = os.read(self._fd, REPORT_BYTES)  # hidraw and packet sockets: one read is one report
        except OSError as error:
            raise self._lost(error) from error
        if not report:
            raise self._lost("its end")
        return report

    def _lost(self, came: object) -> LostSensorError:
        return LostSensorError(expected(self.name, "a readable device", came, "Was it unplugged?"))


def _open(path: str) -> int:
    if not stat.S_ISSOCK(os.stat(path).st_mode):
        return os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    link = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        link.connect(path)
    except OSError:
        link.close()
        raise
    return link.detach()


class UniforceSpaceMouse(UniforceTeleoperator):
    """Push the cap to move, turn it to turn; left button closes, right button opens."""

    config_class = UniforceSpaceMouseConfig
    name = "uniforce_spacemouse"

    def __init__(self, config: UniforceSpaceMouseConfig) -> None:
        super().__init__(config, config.limits)
        self.reader = SampleReader(SpaceMouseSource(config.device), LIMITS)

    @property
    def is_connected(self) -> bool:
        """Whether the device is drained."""
        return self.reader.is_running

    def _open(self) -> None:
        self.reader.start()
        self.reader.wait_newer(-1, 1000.0)  # the state of rest, which the source gives at once

    def _close(self) -> None:
        self.reader.stop()

    def _begin(self, measured: np.ndarray) -> None:
        if np.abs(self._deflection()).max() > 0:
            do = "Let go of the cap, then start."
            raise TeleoperatorError(expected(self.name, "a cap at rest", "a deflected one", do), "far")

    def _next(self, elapsed_s: float) -> np.ndarray:
        return self.integrator.advance(self.rates(), elapsed_s, self.measured)

    def rates(self) -> np.ndarray:
        """(5,) wanted speed of each axis, −1 … 1.

        Raises:
            TeleoperatorError: a deflected cap has gone silent.
            SensorError: the device is lost.
        """
        state = self._deflection()
        right, forward, up = self.config.signs[:3] * state[:3]
        c, s = np.cos(self.config.operator_yaw_rad), np.sin(self.config.operator_yaw_rad)
        x, y = c * forward + s * right, s * forward - c * right
        turn = self.config.signs[3] * state[TURN_ABOUT_Z]
        return np.array([x, y, up, turn, state[7] - state[6]])

    def _deflection(self) -> np.ndarray:
        """(8,) six axes in −1 … 1 outside the dead band, and two buttons."""
        sample = self.reader.newest(FOREVER_MS)
        state = sample.data.copy()
        share = np.clip(state[:6] / FULL_SCALE, -1, 1)
        beyond = np.maximum(np.abs(share) - self.config.deadband, 0) / (1 - self.config.deadband)
        state[:6] = np.sign(share) * beyond
        silent_s = sample.age_ms() / 1e3
        if beyond.any() and silent_s > SILENT_S:
            came = f"none for {silent_s:.2f} s with the cap deflected"
            do = "Replug it, or its receiver."
            raise TeleoperatorError(expected(self.name, "reports", came, do), "stale")
        return state
