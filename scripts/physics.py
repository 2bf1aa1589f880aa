"""See uniforce_vtla/commands/physics.py."""

import sys

from uniforce_vtla.commands.physics import main

if __name__ == "__main__":
    sys.exit(main())
