"""
Quartets of wave vectors
========================

Waves of random phases have no coherence in fours; those that exchange energy do. Here one quartet, a wave
vector and its mirror images, is planted in a Gaussian sea: the phase of the fourth is that of the others.
"""

import numpy as np
import xarray as xr

import wavefield as wf
from wavefield import figures
from wavefield.waves import ResonanceSettings

rng = np.random.default_rng(2)
steps, nodes, step = 3072, 36, 0.06
omega = 2 * np.pi * np.fft.fftfreq(steps, 0.05)[:, None, None]
k = 2 * np.pi * np.fft.fftfreq(nodes, step)
length = np.hypot(k[:, None], k)
ridge = np.sqrt(9.81 * length)
# waves exp(i (k . x - omega t)) near the dispersion relation, lengths .2 to 1 m
amplitude = np.exp(-(((omega + ridge) / 0.6) ** 2) / 2) * ((length > 6) & (length < 30))
random = rng.standard_normal((2, steps, nodes, nodes), dtype="f4")
w = np.fft.ifftn(amplitude * (random[0] + 1j * random[1])).real[:, :24, :32]
t, y, x = np.arange(steps) * 0.05, np.arange(24) * step, np.arange(32) * step

# three trains whose amplitudes last a second or so, and a fourth that goes with them
slow = np.exp(-(omega.ravel() ** 2) / 2)
trains = [np.fft.ifft(slow * (rng.standard_normal((steps, 2)) @ [1, 1j])) for _ in "abc"]
trains.append(trains[0] * trains[1] * trains[2].conj())
ky, kx = 8 * np.pi / (24 * step), 8 * np.pi / (32 * step)
for train, (a, b) in zip(trains, ((1, 1), (-1, -1), (1, -1), (-1, 1)), strict=True):
    turned = train * np.exp(-1j * np.sqrt(9.81 * np.hypot(ky, kx)) * t) / np.sqrt((np.abs(train) ** 2).mean())
    plane = np.exp(1j * (a * ky * y[:, None] + b * kx * x))
    w = w + 0.4 * w.std() * (turned[:, None, None] * plane).real
axes = {"time": t, "y": y, "x": x}
w = xr.DataArray(w.astype("f4"), axes, ("time", "y", "x"), name="w", attrs={"units": "m s-1"})

# %%
# In a wave store this is the group ``resonances``.
found = wf.resonances(w)
figures.resonance_map(found)

# %%
# With k1 and k2 fixed, the third wave of resonant quartets lies on a curve.
pair = ((kx, ky), (-kx, -ky))
figures.quartet_map(wf.resonances(w, settings=ResonanceSettings(pair=pair)))
