"""See commands/uniforce_commands/bench.py."""

import sys

from uniforce_commands.bench import main

if __name__ == "__main__":
    sys.exit(main())
