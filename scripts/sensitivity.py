"""See commands/uniforce_commands/sensitivity.py."""

import sys

from uniforce_commands.sensitivity import main

if __name__ == "__main__":
    sys.exit(main())
