"""See commands/uniforce_commands/record_pairs.py."""

import sys

from uniforce_commands.record_pairs import main

if __name__ == "__main__":
    sys.exit(main())
