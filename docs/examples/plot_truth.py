"""
The truth of a simulated tank
================================

Errors of the measurement against the exact fields of the experiment.
"""

import xarray as xr

import wavefield as wf
from wavefield import figures
from wavefield.reports import errors_against

cube = wf.open_cube("wavefield-demo/cube.zarr")
truth = xr.open_zarr("wavefield-demo/truth/truth.zarr", consolidated=False)
errors = errors_against(cube, truth).isel(x=slice(4, -4), y=slice(4, -4))
pixel = float(cube.attrs["pixel_size"])
figures.error_distributions(errors, pixel)
