"""See commands/uniforce_commands/physics.py."""

import sys

from uniforce_commands.physics import main

if __name__ == "__main__":
    sys.exit(main())
