"""Web pages, served on this computer, that show a cube, or an experiment while its cameras record."""
