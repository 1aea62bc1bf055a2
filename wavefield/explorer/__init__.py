"""Interactive pages, served locally: a cube, or an experiment while its cameras write."""
