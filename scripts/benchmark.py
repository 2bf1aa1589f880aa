"""See uniforce_vtla/commands/benchmark.py."""

import sys

from uniforce_vtla.commands.benchmark import main

if __name__ == "__main__":
    sys.exit(main())
