"""
Uncertainties and residuals
===========================

Every value has a standard uncertainty. Epipolar errors and misfits between cameras show further errors.
"""

import wavefield as wf
from wavefield import figures

cube = wf.open_cube("wavefield-demo/cube.zarr")
figures.uncertainty_maps(cube)

# %%
# Where the cameras disagree: a pattern that stays in place points to the calibration.
figures.misfit_maps(cube)

# %%
# How often each node was measured, and the faults over the run.
figures.coverage_map(cube)

# %%
figures.fault_history(cube)
