"""See uniforce_vtla/commands/blind.py."""

import sys

from uniforce_vtla.commands.blind import main

if __name__ == "__main__":
    sys.exit(main())
