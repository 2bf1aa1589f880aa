"""See commands/uniforce_commands/scene_gauge.py."""

import sys

from uniforce_commands.scene_gauge import main

if __name__ == "__main__":
    sys.exit(main())
