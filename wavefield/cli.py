"""Where the command line was: for environments installed before it moved to `wavefield.commands.cli`."""

from wavefield.commands.cli import main as main
