"""See commands/uniforce_commands/train.py."""

import sys

from uniforce_commands.train import main

if __name__ == "__main__":
    sys.exit(main())
