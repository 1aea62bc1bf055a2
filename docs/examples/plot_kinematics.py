"""
The nonlinear term
==================

At the surface z_t = w - u . grad z. All terms are measured independently; the residual is their error.
"""

import xarray as xr

import wavefield as wf
from wavefield import figures

cube = wf.open_cube("wavefield-demo/cube.zarr")
figures.kinematics_maps(cube.isel(time=20))

# %%
# Coherence of the rate of rise with each term.
waves = xr.open_datatree("wavefield-demo/waves.zarr", engine="zarr", consolidated=False)
figures.coherence_curves(waves["coherence"].to_dataset())
