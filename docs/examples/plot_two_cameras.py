"""
Two cameras
===========

The same water measured by three cameras and by two of them.
"""

import xarray as xr

import wavefield as wf
from wavefield.reports import errors_against
from wavefield.variables import Quality

frames = xr.open_datatree("wavefield-demo/experiment.yaml", engine="wavefield")
rig = wf.Rig.load("wavefield-demo/truth/rig.yaml")
truth = xr.open_zarr("wavefield-demo/truth/truth.zarr", consolidated=False)
grid = wf.Grid(x=(-0.26, 0.26), y=(-0.18, 0.18), step=0.01)

pair = wf.Rig({name: rig[name] for name in ("cam1", "cam2")})
two = (
    wf.reconstruct({name: frames[name].image for name in pair}, pair, grid=grid)
    .isel(time=slice(20, 22))
    .load()
)
three = wf.open_cube("wavefield-demo/cube.zarr").isel(time=slice(20, 22)).load()
two.z.isel(time=0).plot()

# %%
# Median errors of z (mm) and velocity (mm/s) over measured nodes: three cameras, then two.
for cube in (three, two):
    errors = errors_against(cube, truth).where((cube.quality & Quality.MEASURED) > 0)
    print({name: round(1e3 * float(abs(errors[name]).median()), 3) for name in ("z", "u", "v", "w")})
