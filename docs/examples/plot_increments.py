"""
Increments
==========

Are large differences over short lags more frequent than in a Gaussian field? A spectrum does not show this.
Here waves come in groups, and their amplitude varies from group to group.
"""

import numpy as np
import xarray as xr

import wavefield as wf
from wavefield import figures

rng = np.random.default_rng(5)
steps, nodes, step = 1024, 64, 0.04
omega = 2 * np.pi * np.fft.fftfreq(steps, 0.05)[:, None, None]
line = 2 * np.pi * np.fft.fftfreq(nodes, step)
ky, kx = np.meshgrid(line, line, indexing="ij")
k = np.maximum(np.hypot(ky, kx), 1e-9)


def field(spectrum):
    """A Gaussian field (time, y, x) of waves exp(i (k . x - omega t)) with this spectrum."""
    random = rng.standard_normal((2, *spectrum.shape), dtype="f4")
    return np.fft.ifftn(np.sqrt(spectrum) * (random[0] + 1j * random[1])).real[:, :40, :48]


waves = field(np.exp(-(((omega + np.sqrt(9.81 * k)) / 0.4) ** 2)) * ((k > 9) & (k < 35)) * k**-4.0)
groups = field(np.exp(-((omega / 0.5) ** 2) - (k / 3) ** 2))
u = waves * np.exp(groups / groups.std())
axes = {"time": np.arange(steps) * 0.05, "y": np.arange(40) * step, "x": np.arange(48) * step}
u = xr.DataArray(0.05 * u / u.std(), axes, tuple(axes), attrs={"units": "m s-1"})

# %%
# The flatness of a Gaussian field is 3; the groups raise it by more than its standard uncertainty.
figures.flatness_curves(wf.structure_functions(u))
