"""
Increments, waves and vortices
==============================

Two questions that a spectrum leaves open: are large differences over short lags more frequent than in a
Gaussian field, and does the water at the surface swirl? Here a Gaussian sea carries vortices that hold a
tenth of its variance and that come in patches; of these, what turns slower than a segment lasts does not
count.
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
band = (k > 9) & (k < 35)


def noise(spectrum):
    """A Gaussian field of that spectrum, (time, y, x), complex lines of waves exp(i (k . x - omega t))."""
    random = rng.standard_normal((2, *spectrum.shape), dtype="f4")
    return np.sqrt(spectrum) * (random[0] + 1j * random[1])


def field(lines):
    """What is seen of waves of these lines, (time, y, x)."""

    return np.fft.ifftn(lines).real[:, :40, :48]


waves = noise(np.exp(-(((omega + np.sqrt(9.81 * k)) / 0.4) ** 2)) * band * k**-4.0)
eddies = noise(np.exp(-((omega / 4) ** 2)) * band * k**-3.0)
u, v = (field(waves * along / k) for along in (kx, ky))
swirl = [field(eddies * across / k) for across in (-ky, kx)]
slow = field(noise(np.exp(-((omega / 0.5) ** 2) - (k / 3) ** 2)))
patches = np.exp(slow / slow.std())
patches /= np.sqrt((patches**2).mean())
size = np.sqrt(0.1 * (u.var() + v.var()) / (swirl[0].var() + swirl[1].var()))
scale = 0.05 / u.std()
axes = {"time": np.arange(steps) * 0.05, "y": np.arange(40) * step, "x": np.arange(48) * step}
cube = xr.Dataset(
    {
        name: (tuple(axes), scale * (wave + size * patches * eddy), {"units": "m s-1"})
        for name, wave, eddy in zip("uv", (u, v), swirl, strict=True)
    },
    axes,
)

# %%
# What moves along the wave vector are waves, what moves across it are vortices.
figures.vortex_spectra(wf.waves_and_vortices(cube, segment=128))

# %%
# Flatness 3 is a Gaussian field's; the patches raise it by more than its error.
figures.flatness_curves(wf.structure_functions(cube.u))
