"""See uniforce_vtla/commands/agreement.py."""

import sys

from uniforce_vtla.commands.agreement import main

if __name__ == "__main__":
    sys.exit(main())
