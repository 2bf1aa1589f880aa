"""See uniforce_vtla/commands/convert.py."""

import sys

from uniforce_vtla.commands.convert import main

if __name__ == "__main__":
    sys.exit(main())
