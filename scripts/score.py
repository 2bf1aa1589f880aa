"""``python scripts/score.py key=value …``, the same as ``uniforce score``."""

import sys

from uniforce_cli.main import main

if __name__ == "__main__":
    sys.exit(main(["score", *sys.argv[1:]]))
