"""Figures of the kinematic condition z_t = w - u . grad z: nonlinear term, residual, and coherence."""

import numpy as np
import xarray as xr
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from wavefield.figures.display import POSITIVE, limit
from wavefield.figures.style import (
    CYCLES,
    HERTZ,
    LINES,
    cycles,
    draw_cells,
    draw_curves,
    draw_map,
    finish,
    hertz,
    map_panels,
    moment_title,
    panels,
)

_COHERENCES = {"w": "z_t with w", "nl": "z_t with −u·∇z", "tot": "z_t with w − u·∇z"}
_TERMS = {"nonlinear": "nonlinear term u·∇z", "residual": "residual z_t − w + u·∇z"}


def kinematics_maps(snapshot: xr.Dataset) -> Figure:
    """Draw maps of z, w, the nonlinear term u . grad z, and the residual z_t - w + u . grad z.

    The last two share one colour scale. Aubourg et al. (2019) show such maps.

    Parameters
    ----------
    snapshot : Dataset, (y, x)
        One step of a cube with z (m) and z_t, u, v, w (m s-1).

    Returns
    -------
    Figure
    """
    from wavefield.waves.motion import kinematics_at  # slow to import: compiled kernels

    figure, axes = map_panels(snapshot.z, 2, 2)
    title = f"elevation, {moment_title(snapshot)}"
    draw_map(axes[0, 0], snapshot.z, "z (cm)", factor=100, title=title)
    draw_map(axes[0, 1], snapshot.w, "w (cm s⁻¹)", factor=100, title="vertical velocity")
    terms = kinematics_at(snapshot)
    half = 100 * limit(terms.nonlinear)
    for ax, (name, title) in zip(axes[1], _TERMS.items(), strict=True):
        draw_map(ax, terms[name], "cm s⁻¹", factor=100, scale=(-half, half), title=title)
    return figure


def coherence_curves(coherence: xr.Dataset) -> Figure:
    """Draw the coherence of z_t with w, with -u . grad z, and with the sum of both, over wavenumber.

    In a mean current U, z_t stands for z_t + U . grad z, and u for u - U. Left: normalised as in Aubourg et
    al. (2019). Right: the magnitude-squared coherence, with the level that unrelated signals exceed in 5 % of
    cases. Lines are thin and pale where the store marks them as not valid.

    Parameters
    ----------
    coherence : Dataset
        Group ``/coherence`` of a wave store.

    Returns
    -------
    Figure
    """
    figure, [[left, right]] = panels(2)
    k, valid = cycles(coherence), coherence["valid"].values if "valid" in coherence else None
    for ax, name in ((left, "C"), (right, "gamma2")):
        curves = {label: np.abs(coherence[name].sel(term=term).values) for term, label in _COHERENCES.items()}
        draw_curves(ax, k, curves, valid=valid)
    right.plot(k, coherence.level.sel(term="w").values, color="0.5", linestyle=":", label="chance (5 %)")
    finish(left, CYCLES, "|C(k)|, common normalisation (1)", ylim=(0, 1.1))
    finish(right, CYCLES, "γ²(k) (1)", ylim=(0, 1.05))
    return figure


def plane_coherence_maps(plane: xr.Dataset) -> Figure:
    """Draw the coherence of z_t with w - u . grad z at each wave vector, and its mean over the angle.

    The mean is also drawn for w and for -u . grad z alone. z_t and u are relative to the mean current.

    Parameters
    ----------
    plane : Dataset
        The result of `wavefield.waves.plane_coherence`.

    Returns
    -------
    Figure
    """
    figure, [[left, right]] = panels(2, height=4.4)
    kx, ky = (plane[name].values / (2 * np.pi) for name in ("kx", "ky"))
    label = "|C(k)| of z_t with w − u·∇z"
    draw_cells(left, kx, ky, plane.plane_C.sel(term="tot").values, label, Normalize(0, 1), POSITIVE)
    left.set(xlabel="kx / 2π (m⁻¹)", ylabel="ky / 2π (m⁻¹)", aspect="equal")
    curves = {label: plane.mean_C.sel(term=term).values for term, label in _COHERENCES.items()}
    draw_curves(right, cycles(plane), curves)
    finish(right, CYCLES, "|C|, averaged after the ratio", ylim=(0, 1.1))
    return figure


def nonlinear_ratio_curves(ratio: xr.Dataset) -> Figure:
    """Draw the ratio of the nonlinear term to the vertical velocity over wavenumber and over frequency.

    The band is the 95 % interval. The nonlinear term is (u - U) . grad z, with the mean current U.

    Parameters
    ----------
    ratio : Dataset
        Group ``/kinematics`` of a wave store, as from `wavefield.analyze`.

    Returns
    -------
    Figure
    """
    figure, axes = panels(2)
    top = 0.0
    for ax, axis, x, label in zip(
        axes[0], ("k", "omega"), (cycles(ratio), hertz(ratio)), (CYCLES, HERTZ), strict=True
    ):
        middle, low, high = (ratio[f"{end}nonlinear_ratio_{axis}"].values for end in ("", "low_", "high_"))
        ax.fill_between(x, low * middle, high * middle, color=LINES[1]["color"], alpha=0.25, linewidth=0)
        ax.plot(x, middle, **LINES[1])
        top = max(top, float(np.nanpercentile(middle, 95)))
        finish(ax, label, "(u − U)·∇z over w, amplitude (1)")
    for ax in axes[0]:
        ax.set_ylim(0, 1.3 * top or 1.0)
    return figure
