"""See commands/uniforce_commands/bench_policy.py."""

import sys

from uniforce_commands.bench_policy import main

if __name__ == "__main__":
    sys.exit(main())
