"""See commands/uniforce_commands/train_arm.py."""

import sys

from uniforce_commands.train_arm import main

if __name__ == "__main__":
    sys.exit(main())
