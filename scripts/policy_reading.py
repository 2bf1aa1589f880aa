"""See commands/uniforce_commands/policy_reading.py."""

import sys

from uniforce_commands.policy_reading import main

if __name__ == "__main__":
    sys.exit(main())
