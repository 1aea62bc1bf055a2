"""
Free and bound waves
====================

Two waves force one at the sum of their frequencies and wave vectors and one at the difference. These lie
beside the ridge of the dispersion relation. Here is a sea whose second-order waves are known exactly.
"""

import numpy as np
import xarray as xr

import wavefield as wf
from wavefield import figures
from wavefield.tank.sea import Sea

rng = np.random.default_rng(4)
# on the lattice of a basin of 8 m the forced waves are few enough to be quick
n = np.stack(np.meshgrid(np.arange(-14, 15), np.arange(-14, 15)), -1).reshape(-1, 2)
k = 2 * np.pi / 8 * n
length = np.hypot(*k.T)
k = k[(length > 4) & (length < 11)]
k = k[rng.choice(len(k), 60, replace=False, p=(w := np.hypot(*k.T) ** -3.0) / w.sum())]
sea = Sea(*k.T, 0.0018 * np.exp(2j * np.pi * rng.random(60)), depth=0.7, bound=60)
t, y, x = np.arange(256) * 0.05, np.arange(40) * 0.04, np.arange(48) * 0.04
z = xr.DataArray(
    np.stack([sea.on_grid(x, y, now, ("z",))["z"] for now in t]),
    {"time": t, "y": y, "x": x},
    ("time", "y", "x"),
    attrs={"units": "m"},
)

# %%
# The spectrum of each. In a wave store they are the group ``bound``.
spectrum = wf.spectrum(z, segment=128)
bound = wf.free_and_bound(spectrum.E, depth=0.7, dof=float(spectrum.dof))
figures.bound_spectra(bound)

# %%
# The waves themselves: the elevation of the bound ones over x and y.
fields = wf.free_and_bound_fields(z.to_dataset(name="z"), bound, segment=128)
middle = fields.isel(time=128)
figures.elevation_map(middle.assign(z=middle.z_bound))
