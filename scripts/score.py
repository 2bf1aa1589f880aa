"""See commands/uniforce_commands/score.py."""

import sys

from uniforce_commands.score import main

if __name__ == "__main__":
    sys.exit(main())
