"""See uniforce_vtla/commands/scene_gauge.py."""

import sys

from uniforce_vtla.commands.scene_gauge import main

if __name__ == "__main__":
    sys.exit(main())
