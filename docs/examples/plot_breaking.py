"""
Crests about to break
=====================

A crest breaks when its water outruns it: B = u / c beyond .85 or so. A steep group of waves, exact to second
order, with B at every crest.
"""

import numpy as np
import xarray as xr

import wavefield as wf
from wavefield import figures
from wavefield.tank.sea import Sea

kx = 2 * np.pi / 4 * np.array([5.0, 6, 7, 8])
sea = Sea(kx, np.array([1.5, 0, 0, -1.5]), 0.012 * np.ones(4), depth=0.7, bound=4)
t, y, x = np.arange(-8, 8) * 0.05, np.arange(-40, 40) * 0.01, np.arange(-80, 80) * 0.01
steps = [sea.on_grid(x, y, now, ("z", "z_t", "u", "v")) for now in t]
axes = {"time": t, "y": y, "x": x}
cube = xr.Dataset(
    {name: (("time", "y", "x"), np.stack([one[name] for one in steps])) for name in steps[0]}, axes
)

# %%
# Crests in colour over the elevation.
found = wf.breaking(cube, onset=0.5)
figures.breaking_map(xr.merge([cube, found.B]).isel(time=8))

# %%
# Crests beyond the onset are events, with their history.
found[["event_time", "event_x", "event_y", "event_B", "event_duration", "event_length"]].to_dataframe()
