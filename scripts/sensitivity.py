"""See uniforce_vtla/commands/sensitivity.py."""

import sys

from uniforce_vtla.commands.sensitivity import main

if __name__ == "__main__":
    sys.exit(main())
