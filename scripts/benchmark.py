"""See commands/uniforce_commands/benchmark.py."""

import sys

from uniforce_commands.benchmark import main

if __name__ == "__main__":
    sys.exit(main())
