"""
Current by depth
================

Short waves feel the water near the surface, long ones that further down. Here a sea runs over a current that
falls off as 0.1 exp(z / 0.1 m) m/s; its waves are shifted as linear theory has it.
"""

import numpy as np
import xarray as xr

import wavefield as wf
from wavefield import figures

rng = np.random.default_rng(1)
steps, nodes, step = 512, 96, 0.03
omega = 2 * np.pi * np.fft.fftfreq(steps, 0.05)[:, None, None]
k = 2 * np.pi * np.fft.fftfreq(nodes, step)
length = np.hypot(k[:, None], k)
felt = 0.1 * 2 * length / (2 * length + 1 / 0.1)  # 2 k times the integral of U exp(2 k z)
free = np.sqrt(9.81 * length + 7.28e-5 * length**3)
amplitude = np.exp(-(((omega + free + k * felt) / 0.06) ** 2) / 2) / np.maximum(free, 1) ** 2.5
amplitude *= (free > 7.5) & (free < 26)
random = rng.standard_normal((2, steps, nodes, nodes), dtype="f4")
w = np.fft.ifftn(amplitude * (random[0] + 1j * random[1])).real[:, :64, :80]
axes = {"time": np.arange(steps) * 0.05, "y": np.arange(64) * step, "x": np.arange(80) * step}
w = xr.DataArray(w.astype("f4"), axes, ("time", "y", "x"), attrs={"units": "m s-1"})

# %%
# The ridge of the spectrum, band by band; u and v of the surface are the point at depth 0. In a wave store it
# is the group ``shear``.
spectrum = wf.spectrum(w, segment=256)
ridge = wf.fit_dispersion(spectrum.E)
current = wf.current_by_depth(ridge, surface=(0.1, 0.0))
figures.current_profile(current)
