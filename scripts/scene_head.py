"""See uniforce_vtla/commands/scene_head.py."""

import sys

from uniforce_vtla.commands.scene_head import main

if __name__ == "__main__":
    sys.exit(main())
