"""
Crests and troughs
==================

Second-order waves have sharper crests and flatter troughs than a Gaussian sea. The figure compares the
exceedance of crests and troughs with the laws of Rayleigh (Gaussian) and Tayfun (second order).
"""

import numpy as np
import xarray as xr
from scipy.signal import hilbert

import wavefield as wf
from wavefield import figures

# long-crested waves about 1.4 Hz with those that they force at twice their phase, z = a + k (a^2 - h^2) / 2
rng = np.random.default_rng(3)
k = np.clip(rng.normal(7.9, 1.0, 60), 4, 12)
phase = 2 * np.pi * rng.random(60)
t, x = np.arange(4000) * 0.05, np.arange(8) * 0.3
turn = np.outer(np.sqrt(9.81 * k), t) + phase[:, None]
a = np.stack([0.0028 * np.cos(k[:, None] * at - turn).sum(0) for at in x], -1)
z = a + 7.9 / 2 * (a**2 - hilbert(a, axis=0).imag ** 2)
axes = {"time": t, "y": np.arange(8) * 0.3, "x": x}
field = z[:, None, :] + np.zeros((8, 1))
cube = xr.Dataset({"z": (("time", "y", "x"), field, {"units": "m"})}, axes)

# %%
# Uncertainties come from a bootstrap over blocks of ten mean periods.
crests = wf.crest_statistics(cube)
figures.crest_curves(crests)

# %%
crests[["significant_height", "significant_height_std", "skewness", "skewness_std", "kurtosis", "waves"]]
