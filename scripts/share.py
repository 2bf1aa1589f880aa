"""See commands/uniforce_commands/share.py."""

import sys

from uniforce_commands.share import main

if __name__ == "__main__":
    sys.exit(main())
