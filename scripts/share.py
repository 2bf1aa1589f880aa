"""See uniforce_vtla/commands/share.py."""

import sys

from uniforce_vtla.commands.share import main

if __name__ == "__main__":
    sys.exit(main())
