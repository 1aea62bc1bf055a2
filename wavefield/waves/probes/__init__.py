"""Wave probes: their files, and their fit to the cube."""
