"""See commands/uniforce_commands/pair_quality.py."""

import sys

from uniforce_commands.pair_quality import main

if __name__ == "__main__":
    sys.exit(main())
