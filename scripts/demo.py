"""See commands/uniforce_commands/demo.py."""

import sys

from uniforce_commands.demo import main

if __name__ == "__main__":
    sys.exit(main())
