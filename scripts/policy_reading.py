"""See uniforce_vtla/commands/policy_reading.py."""

import sys

from uniforce_vtla.commands.policy_reading import main

if __name__ == "__main__":
    sys.exit(main())
