"""The nonlinear term, the residual of the kinematic condition, and how the terms cohere."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from wavefield.figures.style import LINES, draw_map, limit, map_panels, moment_title, panels, plain_axes


def kinematics_maps(snapshot: xr.Dataset, cube: xr.Dataset | None = None) -> Figure:
    """Elevation, vertical velocity, nonlinear term and residual at one moment.

    Parameters
    ----------
    snapshot : Dataset, (y, x)
        One step of a cube with z (m) and z_t, u, v, w (m s-1).
    cube : Dataset, (time, y, x), optional
        As `wavefield.waves.kinematics_at` takes it.

    Returns
    -------
    Figure

    Notes
    -----
    Counterpart of the paper's maps of eta, u . grad eta and the error field. The residual has the scale of
    the nonlinear term, so that one sees which part of it is measured.
    """
    from wavefield.waves.nonlinear.kinematics import (
        kinematics_at,  # imports all of the waves, other figures do not
    )

    drawn = kinematics_at(snapshot, cube)
    figure, axes = map_panels(snapshot.z, 2, 2)
    draw_map(axes[0, 0], snapshot.z, "z (cm)", factor=100, title=f"elevation, {moment_title(snapshot)}")
    draw_map(axes[0, 1], snapshot.w, "w (cm s⁻¹)", factor=100, title="vertical velocity")
    half = 100 * limit(drawn.nonlinear)
    for ax, name, title in (
        (axes[1, 0], "nonlinear", "nonlinear term u·∇z"),
        (axes[1, 1], "residual", "residual z_t − w + u·∇z"),
    ):
        draw_map(ax, drawn[name], "cm s⁻¹", factor=100, scale=(-half, half), title=title)
    return figure


def coherence_curves(coherence: xr.Dataset) -> Figure:
    """Coherence of z_t with w, with -u . grad z, and with their sum.

    Parameters
    ----------
    coherence : Dataset
        Group ``/coherence`` of a wave store.

    Returns
    -------
    Figure

    Notes
    -----
    Counterpart of the paper's coherence curves, with its common normalisation, on the left; the standard
    magnitude-squared coherence with its level of chance on the right.
    """
    figure, axes = panels(2)
    left, right = axes[0]
    cycles = coherence.k.values / (2 * np.pi)
    labels = {"w": "z_t with w", "nl": "z_t with −u·∇z", "tot": "z_t with w − u·∇z"}
    for style, (name, label) in zip((LINES[0], LINES[1], LINES[2]), labels.items(), strict=True):
        left.plot(cycles, np.abs(coherence[f"C_{name}"].values), label=label, **style)
        right.plot(cycles, coherence[f"gamma2_{name}"].values, label=label, **style)
    left.set(xlabel="k / 2π (m⁻¹)", ylabel="|C(k)|, common normalisation (1)", ylim=(0, 1.1))
    right.plot(cycles, coherence.level_w.values, color="0.5", linestyle=":", label="chance (5 %)")
    right.set(xlabel="k / 2π (m⁻¹)", ylabel="γ²(k) (1)", ylim=(0, 1.05))
    for ax in axes[0]:
        plain_axes(ax)
    return figure


def balance_history(kinematics: xr.Dataset) -> Figure:
    """Course of the rms of the terms of the kinematic condition.

    Parameters
    ----------
    kinematics : Dataset
        Group ``/kinematics`` of a wave store.

    Returns
    -------
    Figure
    """
    figure, axes = panels(1, width=7.6, height=3.6)
    ax = axes[0, 0]
    labels = {
        "w_rms": "w",
        "nonlinear_rms": "u·∇z",
        "residual_rms": "residual z_t − w + u·∇z",
        "finite_residual_rms": "residual along finite displacements",
    }
    for style, (name, label) in zip(LINES, labels.items(), strict=False):
        if name in kinematics:
            ax.semilogy(kinematics.time.values, 100 * kinematics[name].values, label=label, **style)
    ax.set(xlabel="time (s)", ylabel="rms over the grid (cm s⁻¹)")
    plain_axes(ax, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
