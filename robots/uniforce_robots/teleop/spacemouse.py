"""Steer with a SpaceMouse: deflection is speed, buttons close and open. Never run on hardware.

Not pyspacemouse or hidapi: they open nothing but a real HID node, so no fault test could run
(pyspacemouse also needs easyhid, which has no wheel).
"""

import logging
import os
import select
import socket
import stat
import struct
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lerobot.teleoperators import TeleoperatorConfig

from uniforce_robots.sensors.faults import LostSensorError, ProtocolError, WrongSensorError
from uniforce_robots.sensors.reader import ReaderLimits, SampleReader, SampleSource, Stamped, now_ns
from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.integrator import SteeringConfig
from uniforce_vtla.errors import SensorError, TeleoperatorError, expected
from uniforce_vtla.options import Range

log = logging.getLogger(__name__)

SYS_HIDRAW = Path("/sys/class/hidraw")
# Vendor and product as the kernel writes them: Logitech's SpaceNavigator, 3Dconnexion's family.
VENDORS = {
    "0000046D": {"0000C626", "0000C627", "0000C628", "0000C629", "0000C62B"},
    "0000256F": None,
}
# of a report descriptor: page "generic desktop", usage "multi-axis controller"
MULTI_AXIS = bytes((5, 1, 9, 8))
MOVE_S = 15.0  # for a person to move the cap that is meant
REPORT_BYTES = 64
READ_TIMEOUT_S = 0.05
BAD_IN_A_ROW = 20  # a third of a second of nothing but nonsense
DO_PLUG = "Plug it in; give yourself read permission on /dev/hidraw* by a udev rule."
FOREVER_MS = 1e12  # a cap at rest is silent until it is touched
# a deflected cap so long without a report is a dead one; wireless ones send at some 60 Hz
SILENT_S = 0.25
# A cap at rest sends nothing, one held still repeats itself: neither is a fault.
LIMITS = ReaderLimits(capacity=64, frozen_after=0, first_ms=2000.0, silent_s=float("inf"))
AXES = 6
BUTTONS = 2  # more buttons exist on some models and mean nothing here
TURN_ABOUT_Z = 5
UNKNOWN = [True] * AXES + [False] * BUTTONS  # a button that is held reports when it is let go
FULL_SCALE = 350.0  # counts at full deflection
LARGEST_COUNT = 2000  # beyond this it is no deflection
_THREE = struct.Struct("<3h")
_SIX = struct.Struct("<6h")


@TeleoperatorConfig.register_subclass("uniforce_spacemouse")
@dataclass(kw_only=True)
class UniforceSpaceMouseConfig(SteeringConfig):
    """A 3Dconnexion SpaceMouse; the limits hold at full deflection."""

    # e.g. /dev/hidraw3, or a local packet socket; empty looks for the only one plugged in
    device: str = ""
    # share of full deflection that is rest; a cap never comes back to zero exactly
    deadband: float = 0.08
    # of right, forward, up, counter-clockwise in counts
    signs: tuple[int, int, int, int] = (1, -1, -1, -1)
    # which way "forward" is in the base frame; 0: the operator looks along +x
    operator_yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        Range(0, 0.9).check("deadband", self.deadband)


def find_spacemice(folder: Path = SYS_HIDRAW) -> list[str]:
    """Return the /dev/hidrawN of every SpaceMouse the kernel knows; a receiver has several."""
    return [f"/dev/{node.name}" for node in sorted(folder.glob("*")) if _is_spacemouse(node)]


def _node(path: str) -> Path:
    return SYS_HIDRAW / Path(path).resolve().name


def _facts(node: Path) -> dict[str, str]:
    """Return the kernel's facts of a hidraw node, e.g. HID_ID, HID_NAME, HID_PHYS; maybe none."""
    uevent = node / "device" / "uevent"
    facts = {}
    if uevent.is_file():
        for line in uevent.read_text(errors="replace").splitlines():
            name, _, value = line.partition("=")
            facts[name] = value
    return facts


def _is_spacemouse(node: Path) -> bool:
    """Return whether its report descriptor, or else its ids, are a multi-axis controller's."""
    descriptor = node / "device" / "report_descriptor"
    if descriptor.is_file():
        return MULTI_AXIS in descriptor.read_bytes()
    *_, vendor, product = f"::{_facts(node).get('HID_ID', '')}".upper().split(":")
    known = VENDORS.get(vendor, set())
    return known is None or product in known


class SpaceMouseSource(SampleSource):
    """HID reports → states (8,) float64: x, y, z and turns about them in counts, two buttons.

    Two layouts are in use. Older: report 1 = x, y, z and report 2 = turns about them, int16 little
    endian. Newer: all six in report 1. Report 3 = buttons, one bit each. The device's own axes: x
    right, y towards the person, z down.

    A thread drains it: a queue in the kernel would let the robot move on after the cap was let go.

    A cap at rest is silent, a deflected one reports at its rate. An axis is at rest once a report
    says so, or once the open device was silent for ``SILENT_S``. Until all axes are known there is
    no sample.

    ``device`` is /dev/hidrawN or a local packet socket, empty for the one whose cap moves.
    ``state`` is the newest, 0 where unknown.
    """

    def __init__(self, device: str = "") -> None:
        super().__init__(f"spacemouse ({device or 'any'})")
        self._device = device
        self.state = np.zeros(AXES + BUTTONS)
        self._unknown = np.array(UNKNOWN)
        self._fd = -1
        self._heard_s = 0.0
        self._bad_in_a_row = 0
        self._place = ""  # USB socket and interface of the one that was moved

    def _connect(self, undo: ExitStack) -> None:
        """Open the device.

        Raises LostSensorError: none there, no permission, several and none moves; WrongSensorError:
        no SpaceMouse.
        """
        path = self._device or self._only_one()
        facts = _facts(_node(path))
        # numbers of hidraw nodes change with every boot
        if facts and not _is_spacemouse(_node(path)):
            do = "Leave device empty, or name the SpaceMouse's own node."
            raise WrongSensorError(
                expected(self.name, "a SpaceMouse", facts.get("HID_NAME", path), do)
            )
        try:
            self._fd = _open(path)
        except OSError as error:
            raise LostSensorError(
                expected(self.name, "a device to read", error, DO_PLUG)
            ) from error
        undo.callback(os.close, self._fd)
        self.state[:] = 0
        self._unknown[:] = UNKNOWN
        self._heard_s = time.monotonic()
        self._bad_in_a_row = 0

    def _only_one(self) -> str:
        """Return the path of the SpaceMouse; of several nodes, the one whose cap is moved."""
        places = {path: _facts(_node(path)).get("HID_PHYS", path) for path in find_spacemice()}
        found = [path for path, place in places.items() if self._place in ("", place)]
        if not found:
            raise LostSensorError(expected(self.name, "a SpaceMouse", "none", DO_PLUG))
        if len(found) > 1:
            found = [self._moved(found)]
            self._place = places[found[0]]  # another time nobody is asked
        return found[0]

    def _moved(self, paths: list[str]) -> str:
        """Return the node that reports while a person moves the cap."""
        names = []
        for path in paths:
            facts = _facts(_node(path))
            names.append(f"{path} ({facts.get('HID_NAME')}, {facts.get('HID_PHYS')})")
        listed = ", ".join(names)
        log.warning("%s: move the cap within %g s, to choose of %s", self.name, MOVE_S, listed)
        nodes = []
        reasons = ["it wasn't moved"]
        with ExitStack() as closing:
            for node in map(SpaceMouseSource, paths):
                closing.callback(node.close)
                try:
                    node.open()
                    nodes.append(node)
                except LostSensorError as error:
                    reasons.append(str(error).rstrip("."))
            deadline_s = time.monotonic() + MOVE_S
            while nodes and time.monotonic() < deadline_s:
                for node in nodes:
                    with suppress(SensorError):
                        node.read()
                    if node.state.any():
                        return node._device
        do = "Name the one that is the SpaceMouse, device=/dev/hidrawN."
        raise LostSensorError(
            expected(self.name, f"a moved cap at one of {listed}", reasons[-1], do)
        )

    def read(self) -> list[Stamped]:
        """Return the state if a report or a silence changed it, and all of it is known."""
        if select.select([self._fd], [], [], READ_TIMEOUT_S)[0]:
            is_news = self._take_next()
        else:
            is_news = bool(self._unknown.any()) and time.monotonic() - self._heard_s > SILENT_S
            if is_news:
                self._unknown[:] = False  # silence means rest
        if not is_news or self._unknown.any():
            return []
        return [Stamped(now_ns(), self.state.copy())]

    def _take_next(self) -> bool:
        """Take the next report; return whether it was understood."""
        try:
            # hidraw and packet sockets: one read is one report
            report = os.read(self._fd, REPORT_BYTES)
            if not report:
                raise OSError("its end")
        except OSError as error:
            raise LostSensorError(
                expected(self.name, "a readable device", error, "Was it unplugged?")
            ) from error
        understood = self.feed(report)
        if understood:
            self._heard_s = time.monotonic()
            self._bad_in_a_row = 0
        else:
            self._bad_in_a_row += 1
        if self._bad_in_a_row >= BAD_IN_A_ROW:
            came = f"{BAD_IN_A_ROW} unknown ones in a row"
            do = "Is this the right hidraw device?"
            raise ProtocolError(expected(self.name, "reports of a SpaceMouse", came, do))
        return understood

    def feed(self, report: bytes) -> bool:
        """Take one report, its id in the first byte; return whether it was understood."""
        understood = bool(report) and self._take(report[0], report[1:])
        self.counts.samples += understood
        self.counts.bad += not understood
        return understood

    def _take(self, report_id: int, body: bytes) -> bool:
        first = 3 * (report_id - 1)
        values = tuple[int, ...]()
        if report_id == 1 and len(body) >= _SIX.size:
            values = _SIX.unpack_from(body)
        elif report_id in (1, 2) and _THREE.size <= len(body) < _SIX.size:
            values = _THREE.unpack_from(body)
        elif report_id == 3 and body:
            first = AXES
            values = tuple((body[0] >> bit) & 1 for bit in range(BUTTONS))
        if max(map(abs, values), default=0) > LARGEST_COUNT:
            return False
        now = slice(first, first + len(values))
        self.state[now] = values
        self._unknown[now] = False
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

    def rates(self) -> np.ndarray:
        """Return (5,) wanted speed of each axis, −1 … 1; SensorError where the device is lost."""
        state = self._deflection()
        right, forward, up = self.config.signs[:3] * state[:3]
        c = np.cos(self.config.operator_yaw_rad)
        s = np.sin(self.config.operator_yaw_rad)
        x = c * forward + s * right
        y = s * forward - c * right
        turn = self.config.signs[3] * state[TURN_ABOUT_Z]
        return np.array([x, y, up, turn, state[7] - state[6]])

    def is_deflected(self) -> bool:
        """Return whether an axis is beyond its dead band or a button is pressed."""
        return bool(self._deflection().any())

    def _deflection(self) -> np.ndarray:
        """Return (8,) six axes in −1 … 1 outside the dead band, and two buttons."""
        sample = self.device.newest(FOREVER_MS)
        share = np.clip(sample.raw[:6] / FULL_SCALE, -1, 1)
        beyond = np.maximum(np.abs(share) - self.config.deadband, 0) / (1 - self.config.deadband)
        silent_s = sample.age_ms / 1e3
        if beyond.any() and silent_s > SILENT_S:
            came = f"none for {silent_s:.2f} s with the cap deflected"
            raise TeleoperatorError(
                expected(self.name, "reports", came, "Replug it, or its receiver."), "stale"
            )
        return np.array([*(np.sign(share) * beyond), *sample.raw[6:]])
