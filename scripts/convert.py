"""See commands/uniforce_commands/convert.py."""

import sys

from uniforce_commands.convert import main

if __name__ == "__main__":
    sys.exit(main())
