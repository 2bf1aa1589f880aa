"""See uniforce_vtla/commands/score.py."""

import sys

from uniforce_vtla.commands.score import main

if __name__ == "__main__":
    sys.exit(main())
