"""Run the command line with ``python -m wavefield``, for example where ``wavefield`` is not on the path."""

import sys

from wavefield.commands.cli import main

if __name__ == "__main__":
    sys.exit(main())
