"""See uniforce_vtla/commands/touch_check.py."""

import sys

from uniforce_vtla.commands.touch_check import main

if __name__ == "__main__":
    sys.exit(main())
