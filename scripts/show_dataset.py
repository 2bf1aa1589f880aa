"""See commands/uniforce_commands/show_dataset.py."""

import sys

from uniforce_commands.show_dataset import main

if __name__ == "__main__":
    sys.exit(main())
