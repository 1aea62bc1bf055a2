"""
Cameras and their frames
========================

The rig from the side and from above, and a frame of each camera.
"""

import xarray as xr

import wavefield as wf
from wavefield import figures

rig = wf.Rig.load("wavefield-demo/truth/rig.yaml")
grid = wf.Grid(x=(-0.26, 0.26), y=(-0.18, 0.18), step=0.01)
figures.rig_views(rig, grid)

# %%
# One frame of each camera with the outline of the grid, and a close-up of the seeding.
frames = xr.open_datatree("wavefield-demo/experiment.yaml", engine="wavefield")
figures.camera_frames({name: frames[name].image[20].values for name in rig}, rig, grid)
