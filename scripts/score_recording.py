"""See commands/uniforce_commands/score_recording.py."""

import sys

from uniforce_commands.score_recording import main

if __name__ == "__main__":
    sys.exit(main())
