"""See commands/uniforce_commands/touch_check.py."""

import sys

from uniforce_commands.touch_check import main

if __name__ == "__main__":
    sys.exit(main())
