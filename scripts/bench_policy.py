"""See uniforce_vtla/commands/bench_policy.py."""

import sys

from uniforce_vtla.commands.bench_policy import main

if __name__ == "__main__":
    sys.exit(main())
