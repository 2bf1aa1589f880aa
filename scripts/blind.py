"""See commands/uniforce_commands/blind.py."""

import sys

from uniforce_commands.blind import main

if __name__ == "__main__":
    sys.exit(main())
