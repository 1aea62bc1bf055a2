"""Waves that are not linear: free and bound ones."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from wavefield.figures.style import LINES, panels, plain_axes


def bound_spectra(bound: xr.Dataset) -> Figure:
    """Spectra of the free and of the bound waves.

    Parameters
    ----------
    bound : Dataset
        Group ``/bound`` of a wave store, or what `wavefield.free_and_bound` gives.

    Returns
    -------
    Figure
    """
    figure, axes = panels(1, width=7.2, height=4.4)
    ax = axes[0, 0]
    hertz = bound.omega.values / (2 * np.pi)
    names = {
        "E_free": "free waves",
        "E_bound": "bound waves",
        "E_harmonic": "of these on the second harmonic",
    }
    top = float(bound.E_free.max())
    for (name, label), line in zip(names.items(), LINES):
        values = bound[name].values
        ax.semilogy(hertz, np.where(values > 1e-9 * top, values, np.nan), label=label, **line)
    fraction, std = 100 * float(bound.bound_fraction), 100 * float(bound.bound_fraction_std)
    ax.set(
        xlabel="ω / 2π (Hz)",
        ylabel="E^z(ω) (m² s rad⁻¹)",
        ylim=(1e-7 * top, 3 * top),
        title=f"bound: {fraction:.2g} ± {std:.1g} % of the variance",
    )
    plain_axes(ax)
    return figure
