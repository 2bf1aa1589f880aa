"""See commands/uniforce_commands/success_over_demos.py."""

import sys

from uniforce_commands.success_over_demos import main

if __name__ == "__main__":
    sys.exit(main())
