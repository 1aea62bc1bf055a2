"""Camera pairs against one another: errors without any truth."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wavefield.figures.style import LINES, densities, panels, plain_axes
from wavefield.measurement.diagnostics import Diagnosis, joined, rms_within


def _draw(axes: Axes, curves: dict[str, np.ndarray], unit: str, *, positive: bool = False) -> None:
    """Draw densities of several samples on one axis, their rms in the legend."""
    rms = {name: rms_within(values)[0] for name, values in curves.items()}
    span = 5 * max([*(value for value in rms.values() if np.isfinite(value)), 1e-12])
    bins = np.linspace(0 if positive else -span, span, 101)
    centres = (bins[1:] + bins[:-1]) / 2
    for style, (name, values) in zip(LINES[1:], curves.items(), strict=False):
        density = densities(values, bins)
        label = f"{name}, rms {rms[name]:.2g} {unit}"
        axes.semilogy(centres, np.where(density > 0, density, np.nan), label=label, **style)
    plain_axes(axes, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=1)


def pair_misfits(diagnosis: Diagnosis) -> Figure:
    """Distributions of eps_y and of eps' of each pair of cameras on its own.

    Counterpart of the paper's distributions of eps_Y for three pairs and of its PIV errors.
    """
    figure, axes = panels(2, height=4.6)
    _draw(axes[0, 0], {joined(pair): 1e3 * values for pair, values in diagnosis.eps_y.items()}, "mm")
    axes[0, 0].set(xlabel="eps_y (mm)", ylabel="probability density (mm⁻¹)")
    curves = {joined(cameras): values for cameras, values in diagnosis.eps_piv.items()}
    _draw(axes[0, 1], curves, "px", positive=True)
    axes[0, 1].set(xlabel="eps' (px)", ylabel="probability density (px⁻¹)")
    return figure


def pair_differences(diagnosis: Diagnosis) -> Figure:
    """Differences between pairs of cameras: of z, of dx, of dy, of dz.

    Counterpart of the paper's differences between the three pairs, and of the recombination of two pairs
    against the direct one. The mean in time of each node is kept.
    """
    pixel = diagnosis.pixel
    curves = {
        f"{joined(one)} minus {joined(other)}": values / pixel
        for (one, other), values in diagnosis.difference.items()
    } | {f"{joined(pair)} recombined minus direct": v / pixel for pair, v in diagnosis.recombined.items()}
    figure, axes = panels(2, 2, height=4.8)
    _draw(axes[0, 0], curves, "px")
    axes[0, 0].set(xlabel="difference of z (px)", ylabel="probability density (px⁻¹)")
    for component, (ax, label) in enumerate(zip(axes.flat[1:], ("dx", "dy", "dz"), strict=True)):
        curves = {
            f"{joined(one)} minus {joined(other)}": values[..., component, :, :] / pixel
            for (one, other), values in diagnosis.moved_difference.items()
        }
        _draw(ax, curves, "px")
        ax.set(xlabel=f"difference of {label} (px)", ylabel="probability density (px⁻¹)")
    return figure
