"""A serial port that isn't one: a pseudo-terminal behind a link of fixed name, that can be unplugged and put back."""

from __future__ import annotations

import os
import tempfile
import termios
import tty
from pathlib import Path


class PseudoTerminal:
    """Open ``path`` as a serial port; ``master`` is our end, −1 while unplugged."""

    def __init__(self, name: str) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix=f"uniforce-{name}-")
        self.path = Path(self._folder.name) / "port"
        self.master = self._slave = -1
        self.plug()

    def plug(self) -> None:
        """Put it in; does nothing when it is."""
        if self.master >= 0:
            return
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self.master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        """Pull it out; does nothing when it is out."""
        if self.master < 0:
            return
        self.path.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self.master)
        self.master = self._slave = -1

    def ends(self) -> list[int]:
        """Return what to select on: our end, while it is in."""
        return [self.master] if self.master >= 0 else []
