"""See commands/uniforce_commands/verify.py."""

import sys

from uniforce_commands.verify import main

if __name__ == "__main__":
    sys.exit(main())
