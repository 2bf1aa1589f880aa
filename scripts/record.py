"""See commands/uniforce_commands/record.py."""

import sys

from uniforce_commands.record import main

if __name__ == "__main__":
    sys.exit(main())
