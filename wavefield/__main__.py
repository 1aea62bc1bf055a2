"""Run the command line by ``python -m wavefield`` where the script ``wavefield`` is not on the path."""

import sys

from wavefield.commands.cli import main

if __name__ == "__main__":
    sys.exit(main())
