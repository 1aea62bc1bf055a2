"""The command line where scripts of an environment are not on the path: ``python -m wavefield``."""

import sys

from wavefield.commands.cli import main

if __name__ == "__main__":
    sys.exit(main())
