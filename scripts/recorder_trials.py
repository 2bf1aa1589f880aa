"""See uniforce_vtla/commands/recorder_trials.py."""

import sys

from uniforce_vtla.commands.recorder_trials import main

if __name__ == "__main__":
    sys.exit(main())
