"""Connect to a robot and its hand with franky, say so, and end: ``probe.py address [hand]``.

A server that accepts and never answers hangs the client's constructor for ever, signals ignored; a child can be killed.
"""

from __future__ import annotations

import sys

from lines import say


def main() -> None:
    """Say ``loaded``, then ``connected`` or ``error``."""
    import franky

    say("loaded")
    try:
        franky.Robot(sys.argv[1], realtime_config=franky.RealtimeConfig.Ignore)
        if "hand" in sys.argv[2:]:
            franky.Gripper(sys.argv[1])
    except franky.IncompatibleVersionException as error:
        say("error", fault="version", text=str(error))
    except (franky.Exception, franky.GripperException) as error:
        say("error", fault="connection", text=str(error))
    else:
        say("connected")


if __name__ == "__main__":
    main()
