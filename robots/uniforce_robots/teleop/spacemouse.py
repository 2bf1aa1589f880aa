"""Steer with a SpaceMouse: deflection is speed, the buttons close and open the fingers. Never run on hardware.

Not pyspacemouse or hidapi: they open nothing but a real HID node, so none of the fault tests can run on them
(pyspacemouse also needs easyhid, which has no wheel).
"""

import os
import re
import select
import socket
import stat
import struct
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lerobot.teleoperators import TeleoperatorConfig

from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.reader import ReaderLimits, SampleReader, SampleSource, Stamped, now_ns
from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.integrator import SteeringConfig
from uniforce_vtla.errors import TeleoperatorError, expected

SYS_HIDRAW = Path("/sys/class/hidraw")
# Vendor and product as the kernel writes them: Logitech's SpaceNavigator, 3Dconnexion's family.
VENDORS = {"0000046D": {"0000C626", "0000C627", "0000C628", "0000C629", "0000C62B"}, "0000256F": None}
REPORT_BYTES = 64
READ_TIMEOUT_S = 0.05
BAD_IN_A_ROW = 20  # a third of a second of nothing but nonsense
DO_PLUG = "Plug it in; give yourself read permission on /dev/hidraw* by a udev rule."
FOREVER_MS = 1e12  # a cap at rest is silent until it is touched
SILENT_S = 0.25  # a deflected cap so long without a report is a dead one; wireless ones send at some 60 Hz
# A cap at rest sends nothing, and one held still the same: neither silence nor repetition is a fault of the device.
LIMITS = ReaderLimits(capacity=64, frozen_after=0, first_ms=1000.0, silent_s=float("inf"))
AXES, BUTTONS = 6, 2  # more buttons exist on some models and mean nothing here
TURN_ABOUT_Z = 5
FULL_SCALE = 350.0  # counts at full deflection
LARGEST_COUNT = 2000  # beyond this it is no deflection
_THREE, _SIX = struct.Struct("<3h"), struct.Struct("<6h")


@TeleoperatorConfig.register_subclass("uniforce_spacemouse")
@dataclass(kw_only=True)
class UniforceSpaceMouseConfig(SteeringConfig):
    """A 3Dconnexion SpaceMouse; the limits hold at full deflection."""

    device: str = ""  # e.g. /dev/hidraw3, or a local packet socket; empty looks for the only one plugged in
    deadband: float = 0.08  # share of full deflection that is rest; a cap never comes back to zero exactly
    signs: tuple[int, int, int, int] = (1, -1, -1, -1)  # of right, forward, up, counter-clockwise in counts
    operator_yaw_rad: float = 0.0  # which way "forward" is in the base frame; 0: the operator looks along +x


def find_spacemice(folder: Path = SYS_HIDRAW) -> list[str]:
    """Return the /dev/hidrawN of every SpaceMouse the kernel knows."""
    found = []
    for uevent in sorted(folder.glob("*/device/uevent")):
        ids = re.search(r"^HID_ID=\w+:(\w+):(\w+)$", uevent.read_text(errors="replace").upper(), re.MULTILINE)
        known = VENDORS.get(ids[1], set()) if ids else set()
        if ids and (known is None or ids[2] in known):
            found.append(f"/dev/{uevent.parts[-3]}")
    return found


class SpaceMouseSource(SampleSource):
    """HID reports → states (8,) float64: x, y, z, turns about x, y, z in counts, left and right button.

    Two layouts are in use. Older: report 1 = x, y, z and report 2 = turns about them, int16 little endian. Newer: all
    six in report 1. Report 3 = buttons, one bit each. The device's own axes: x right, y towards the person, z down.

    A thread drains it: reading slower than the device sends would leave a queue in the kernel, and the robot would
    move on for a second after the cap was let go.

    ``device`` is /dev/hidrawN or a local packet socket, empty for the only SpaceMouse there is; ``state`` the newest.
    """

    def __init__(self, device: str = "") -> None:
        super().__init__(f"spacemouse ({device or 'any'})")
        self._device, self.state = device, np.zeros(AXES + BUTTONS)
        self._fd, self._rest_sent, self._bad_in_a_row = -1, False, 0

    def _connect(self, undo: ExitStack) -> None:
        """Open the device; raises LostSensorError where there is none, several, or no permission."""
        found = [self._device] if self._device else find_spacemice()
        if len(found) != 1:
            do = DO_PLUG if not found else "Name one: device=/dev/hidrawN."
            raise LostSensorError(expected(self.name, "one SpaceMouse", found or "none", do))
        try:
            self._fd = _open(found[0])
        except OSError as error:
            raise LostSensorError(expected(self.name, "a device to read", error, DO_PLUG)) from error
        undo.callback(os.close, self._fd)
        self.state[:], self._rest_sent, self._bad_in_a_row = 0, False, 0

    def read(self) -> list[Stamped]:
        """Return the newest state if anything came; at first the state of rest, since a cap at rest is silent."""
        if not self._rest_sent:
            self._rest_sent = True
            return [Stamped(now_ns(), self.state.copy())]
        if not select.select([self._fd], [], [], READ_TIMEOUT_S)[0]:
            return []
        try:
            report = os.read(self._fd, REPORT_BYTES)  # hidraw and packet sockets: one read is one report
            if not report:
                raise OSError("its end")
        except OSError as error:
            raise LostSensorError(expected(self.name, "a readable device", error, "Was it unplugged?")) from error
        understood = self.feed(report)
        self._bad_in_a_row = 0 if understood else self._bad_in_a_row + 1
        if self._bad_in_a_row >= BAD_IN_A_ROW:
            came, do = f"{BAD_IN_A_ROW} unknown ones in a row", "Is this the right hidraw device?"
            raise ProtocolError(expected(self.name, "reports of a SpaceMouse", came, do))
        return [Stamped(now_ns(), self.state.copy())] if understood else []

    def feed(self, report: bytes) -> bool:
        """Take one report, its id in the first byte; return whether it was understood."""
        understood = self._take(report[0], report[1:]) if report else False
        self.counts.samples += understood
        self.counts.bad += not understood
        return understood

    def _take(self, report_id: int, body: bytes) -> bool:
        first, values = 3 * (report_id - 1), tuple[int, ...]()
        if report_id == 1 and len(body) >= _SIX.size:
            values = _SIX.unpack_from(body)
        elif report_id in (1, 2) and _THREE.size <= len(body) < _SIX.size:
            values = _THREE.unpack_from(body)
        elif report_id == 3 and body:
            first, values = AXES, tuple((body[0] >> bit) & 1 for bit in range(BUTTONS))
        if max(map(abs, values), default=0) > LARGEST_COUNT:
            return False
        self.state[first : first + len(values)] = values
        # above 3: battery level, calibration, LEDs: known to exist, not needed
        return bool(values) or (report_id > 3 and bool(body))


def _open(path: str) -> int:
    if not stat.S_ISSOCK(os.stat(path).st_mode):
        return os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as link:
        link.connect(path)
        return link.detach()


class UniforceSpaceMouse(UniforceTeleoperator):
    """Push the cap to move, turn it to turn; left button closes, right button opens."""

    config_class = UniforceSpaceMouseConfig
    name = "uniforce_spacemouse"

    def __init__(self, config: UniforceSpaceMouseConfig) -> None:
        super().__init__(config)
        self.device = SampleReader(SpaceMouseSource(config.device), LIMITS)

    def _begin(self, measured: np.ndarray) -> None:
        if np.abs(self._deflection()).max() > 0:
            do = "Let go of the cap, then start."
            raise TeleoperatorError(expected(self.name, "a cap at rest", "a deflected one", do), "far")

    def _next(self, elapsed_s: float) -> np.ndarray:
        return self.integrator.advance(self.rates(), elapsed_s, self.measured)

    def rates(self) -> np.ndarray:
        """(5,) wanted speed of each axis, −1 … 1; SensorError where the device is lost."""
        state = self._deflection()
        right, forward, up = self.config.signs[:3] * state[:3]
        c, s = np.cos(self.config.operator_yaw_rad), np.sin(self.config.operator_yaw_rad)
        x, y = c * forward + s * right, s * forward - c * right
        turn = self.config.signs[3] * state[TURN_ABOUT_Z]
        return np.array([x, y, up, turn, state[7] - state[6]])

    def _deflection(self) -> np.ndarray:
        """(8,) six axes in −1 … 1 outside the dead band, and two buttons."""
        sample = self.device.newest(FOREVER_MS)
        share = np.clip(sample.raw[:6] / FULL_SCALE, -1, 1)
        beyond = np.maximum(np.abs(share) - self.config.deadband, 0) / (1 - self.config.deadband)
        silent_s = sample.age_ms / 1e3
        if beyond.any() and silent_s > SILENT_S:
            came = f"none for {silent_s:.2f} s with the cap deflected"
            raise TeleoperatorError(expected(self.name, "reports", came, "Replug it, or its receiver."), "stale")
        return np.array([*(np.sign(share) * beyond), *sample.raw[6:]])
