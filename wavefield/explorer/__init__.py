"""Looking at a cube, and at an experiment while its cameras write: interactive pages on the loopback."""
