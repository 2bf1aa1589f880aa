"""See uniforce_vtla/commands/record.py."""

import sys

from uniforce_vtla.commands.record import main

if __name__ == "__main__":
    sys.exit(main())
