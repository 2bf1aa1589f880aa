"""See uniforce_vtla/commands/leak_check.py."""

import sys

from uniforce_vtla.commands.leak_check import main

if __name__ == "__main__":
    sys.exit(main())
