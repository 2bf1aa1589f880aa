"""``python scripts/train.py key=value …``, the same as ``uniforce train``."""

import sys

from uniforce_cli.main import main

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
