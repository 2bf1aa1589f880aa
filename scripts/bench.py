"""See uniforce_vtla/commands/bench.py."""

import sys

from uniforce_vtla.commands.bench import main

if __name__ == "__main__":
    sys.exit(main())
