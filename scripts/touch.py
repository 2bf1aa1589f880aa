"""See commands/uniforce_commands/touch.py."""

import sys

from uniforce_commands.touch import main

if __name__ == "__main__":
    sys.exit(main())
