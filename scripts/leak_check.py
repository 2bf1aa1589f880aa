"""See commands/uniforce_commands/leak_check.py."""

import sys

from uniforce_commands.leak_check import main

if __name__ == "__main__":
    sys.exit(main())
