"""See uniforce_vtla/commands/view.py."""

import sys

from uniforce_vtla.commands.view import main

if __name__ == "__main__":
    sys.exit(main())
