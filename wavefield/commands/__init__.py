"""The commands, grouped by what they work on; their heavy imports happen when they are called."""
