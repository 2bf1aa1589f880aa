"""``python scripts/record.py key=value …``, the same as ``uniforce record``."""

import sys

from uniforce_cli.main import main

if __name__ == "__main__":
    sys.exit(main(["record", *sys.argv[1:]]))
