"""Opens a SpaceMouse and hands out its states as fast as they come.

A thread of ``SampleReader`` drains it: reading slower than the device sends would leave a queue in the kernel, and the
robot would move on for a second after the cap was let go. Never run on hardware.
"""

from __future__ import annotations

import os
import select
import socket
import stat
from pathlib import Path

from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.samples import now_ns
from uniforce_robots.sensors.sources import SourceCounts, Stamped
from uniforce_robots.teleop.spacemouse_reports import SpaceMouseReports
from uniforce_vtla.errors import expected

SYS_HIDRAW = Path("/sys/class/hidraw")
# Vendor and product as the kernel writes them: Logitech's SpaceNavigator, 3Dconnexion's family.
VENDORS = {"0000046D": {"0000C626", "0000C627", "0000C628", "0000C629", "0000C62B"}, "0000256F": None}
REPORT_BYTES = 64
READ_TIMEOUT_S = 0.05
BAD_IN_A_ROW = 20  # a third of a second of nothing but nonsense
DO_PLUG = "Plug it in; give yourself read permission on /dev/hidraw* by a udev rule."


def find_spacemice(folder: Path = SYS_HIDRAW) -> list[str]:
    """Return the /dev/hidrawN of every SpaceMouse the kernel knows."""
    devices = sorted(folder.iterdir()) if folder.is_dir() else []
    return [f"/dev/{device.name}" for device in devices if _is_spacemouse(device / "device" / "uevent")]


def _is_spacemouse(uevent: Path) -> bool:
    if not uevent.is_file():
        return False
    lines = dict(
        line.split("=", 1) for line in uevent.read_text(errors="replace").splitlines() if "=" in line
    )
    _, _, ids = lines.get("HID_ID", "").upper().partition(":")
    vendor, _, product = ids.partition(":")
    if vendor not in VENDORS:
        return False
    known = VENDORS[vendor]
    return known is None or product in known


class SpaceMouseSource:
    """A ``SampleSource`` of states (8,); see ``SpaceMouseReports``.

    Args:
        device: /dev/hidrawN or a local packet socket; empty for the only SpaceMouse there is.
    """

    def __init__(self, device: str = "") -> None:
        self.name = f"spacemouse ({device or 'any'})"
        self._device = device
        self._reports = SpaceMouseReports()
        self._fd = -1
        self._said_rest = False
        self._bad_in_a_row = 0

    @property
    def counts(self) -> SourceCounts:
        """Reports understood and not."""
        return self._reports.counts

    def open(self) -> None:
        """Open the device.

        Raises:
            LostSensorError: none, several, or no permission.
        """
        path = self._device or self._only_one()
        try:
            self._fd = _open(path)
        except OSError as error:
            raise LostSensorError(expected(self.name, "a device to read", error, DO_PLUG)) from error
        self._reports.forget()
        self._said_rest, self._bad_in_a_row = False, 0

    def read(self) -> list[Stamped]:
        """Return the newest state if anything came; at first the state of rest, since a cap at rest is silent.

        Raises:
            LostSensorError: it was unplugged.
            ProtocolError: it sends nothing a SpaceMouse would.
        """
        if not self._said_rest:
            self._said_rest = True
            return [Stamped(now_ns(), self._reports.state)]
        readable, _, _ = select.select([self._fd], [], [], READ_TIMEOUT_S)
        if not readable or not self._reports.feed(self._one_report()):
            return self._nothing(bool(readable))
        self._bad_in_a_row = 0
        return [Stamped(now_ns(), self._reports.state)]

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

    def _nothing(self, was_bad: bool) -> list[Stamped]:
        self._bad_in_a_row += was_bad
        if self._bad_in_a_row >= BAD_IN_A_ROW:
            do = "Is this the right hidraw device?"
            came = f"{BAD_IN_A_ROW} unknown ones in a row"
            raise ProtocolError(expected(self.name, "reports of a SpaceMouse", came, do))
        return []

    def _lost(self, came: object) -> LostSensorError:
        return LostSensorError(expected(self.name, "a readable device", came, "Was it unplugged?"))

    def _only_one(self) -> str:
        found = find_spacemice()
        if len(found) != 1:
            do = DO_PLUG if not found else "Name one: device=/dev/hidrawN."
            raise LostSensorError(expected(self.name, "one SpaceMouse", found or "none", do))
        return found[0]


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
