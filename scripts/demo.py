"""See uniforce_vtla/commands/demo.py."""

import sys

from uniforce_vtla.commands.demo import main

if __name__ == "__main__":
    sys.exit(main())
