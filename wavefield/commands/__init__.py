"""The command line, grouped by subject; heavy imports happen when a command is called."""
