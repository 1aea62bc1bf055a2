"""The commands of the command line, grouped by subject; slow imports happen when a command is called."""
