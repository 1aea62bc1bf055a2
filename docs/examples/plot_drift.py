"""
Drift and energy
================

Where the water itself goes: its points are followed on the surface, and drift as Stokes has it. And what the
waves carry: energy, its flux, its growth, and what is left unexplained.
"""

import numpy as np
import xarray as xr

import wavefield as wf
from wavefield import figures
from wavefield.tank.sea import Sea

rng = np.random.default_rng(6)
length, angle = 17 + 13 * rng.random(12), rng.normal(0, 0.4, 12)
amplitude = 0.0008 * np.exp(2j * np.pi * rng.random(12))
sea = Sea(length * np.cos(angle), length * np.sin(angle), amplitude, depth=0.7, bound=12)
t, y, x = np.arange(640) * 0.05, np.arange(38) * 0.04, np.arange(46) * 0.04
names = ("z", "u", "v", "w")
moments = [sea.on_grid(x, y, now, names) for now in t]
cube = xr.Dataset(
    {
        name: (
            ("time", "y", "x"),
            np.stack([one[name] for one in moments]),
            {"units": "m" if name == "z" else "m s-1"},
        )
        for name in names
    },
    {"time": t, "y": y, "x": x},
    {"water_depth": 0.7},
)

# %%
# Paths over ten seconds, each from its dot.
paths = wf.surface_paths(cube, duration=10.0, spacing=0.2)
figures.path_map(paths)

# %%
# The drift of the paths beside that of the spectrum, cm/s.
stokes = wf.stokes_drift(wf.spectrum(cube.z).E, depth=0.7)
{
    name: round(100 * float(value), 2)
    for name, value in (("paths", paths.drift_x), ("Stokes", stokes.stokes_x))
}

# %%
# The budget by bands of frequency. This sea neither grows nor decays: the rest is within its error.
figures.energy_bars(wf.energy_budget(cube, bands=(2.0, 2.3, 2.6, 2.9)))
