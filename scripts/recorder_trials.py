"""See commands/uniforce_commands/recorder_trials.py."""

import sys

from uniforce_commands.recorder_trials import main

if __name__ == "__main__":
    sys.exit(main())
