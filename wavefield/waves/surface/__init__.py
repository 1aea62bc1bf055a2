"""Statistics of the surface and of the motion of the water: heights, crests, breaking, drift, vortices."""
