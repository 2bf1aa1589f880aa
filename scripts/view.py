"""See commands/uniforce_commands/view.py."""

import sys

from uniforce_commands.view import main

if __name__ == "__main__":
    sys.exit(main())
