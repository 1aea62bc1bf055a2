"""
The errors that a cube states
==================================

Every value has a standard uncertainty; sight lines that miss one another and displacements that disagree show
more.
"""

import wavefield as wf
from wavefield import figures

cube = wf.open_cube("wavefield-demo/cube.zarr")
figures.uncertainty_maps(cube)

# %%
# Where the cameras disagree: a pattern that stays in place points to the calibration.
figures.misfit_maps(cube)

# %%
# How often each node was measured, and the course of the run.
figures.coverage_map(cube)

# %%
figures.fault_history(cube)
