"""See uniforce_vtla/commands/touch.py."""

import sys

from uniforce_vtla.commands.touch import main

if __name__ == "__main__":
    sys.exit(main())
