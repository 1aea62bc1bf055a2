"""
The surface and its velocity
============================

One step of a cube, at mid-time between two frames.
"""

import wavefield as wf
from wavefield import figures

cube = wf.open_cube("wavefield-demo/cube.zarr")
step = cube.isel(time=20)
figures.surface_3d(step)

# %%
# The vertical velocity in colour, the horizontal one as arrows.
figures.velocity_map(step)

# %%
# The elevation alone.
step.z.plot()
