"""Figures of spectra, dispersion, directions, probes, bicoherence, crests and structure functions."""

import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from wavefield.figures.display import POSITIVE
from wavefield.figures.style import (
    CYCLES,
    HERTZ,
    LINES,
    cycles,
    draw_cells,
    draw_curves,
    edges,
    finish,
    hertz,
    panels,
    positive,
)
from wavefield.water import GRAVITY

_METHODS = {
    "probes": "wave probes",
    "stereo": "stereo z",
    "w": "integrated w",
    "cross": "cross-spectrum of z and w",
    "fusion": "fusion of z and w",
}
_STEPS_DRAWN = 300  # steps of a probe that are drawn; over more steps single waves cannot be compared
_LOWEST_COLOUR = "#440154"  # lowest colour of viridis, for values below the colour scale


def _units(name: str) -> str:
    """Return the unit of E(k, omega) of the variable `name`, z or a velocity, as text for an axis."""
    return f"{'m²' if name == 'z' else 'm² s⁻²'} (rad/m)⁻¹ (rad/s)⁻¹"


def komega_map(spectra: xr.Dataset, dispersion: xr.Dataset | None = None, name: str = "w") -> Figure:
    """Draw the spectrum E(k, omega) of one variable in colour, with the linear dispersion relation.

    Parameters
    ----------
    spectra : Dataset
        Group ``/spectra`` of a wave store.
    dispersion : Dataset, optional
        Group ``/dispersion``, for the theoretical curve.
    name : str, default "w"
        Variable of which the spectrum is drawn.

    Returns
    -------
    Figure
    """
    energy = spectra["E"].sel(quantity=name).transpose("omega", "k")
    frequency, k = hertz(energy), cycles(energy)
    values = positive(energy.values)
    top = float(np.nanmax(values)) if np.isfinite(values).any() else 1.0
    figure, [[ax]] = panels(1, width=10.4, height=4.8)
    ax.set_facecolor(_LOWEST_COLOUR)
    label = f"E$^{name}$(k, ω) ({_units(name)})"
    draw_cells(ax, k, frequency, values, label, LogNorm(top * 1e-7, top), "viridis")
    shown = np.flatnonzero((values > top * 1e-7).any(axis=0))
    right = edges(k)[1 + (shown[-1] if shown.size else -2)]
    if dispersion is not None and "omega_theory" in dispersion:
        k, omega = cycles(dispersion), dispersion.omega_theory.values
        ax.plot(k, omega / (2 * np.pi), color="white", linewidth=2.6)
        ax.plot(k, omega / (2 * np.pi), color="black", linewidth=1.3, label="linear dispersion relation")
        deep = np.sqrt(GRAVITY * dispersion.k.values) / (2 * np.pi)
        ax.plot(k, deep, color="white", linewidth=1.0, linestyle="--", label="ω = √(gk)")
        ax.legend(loc="lower right", fontsize=9, framealpha=0.9, facecolor="0.6")
        # waves of higher frequency are aliased, so the axis ends a little beyond them
        fastest = np.interp(2 * np.pi * frequency[-1], omega, dispersion.k.values)
        right = min(right, 1.25 * float(fastest) / (2 * np.pi))
    ax.set(xlabel=CYCLES, ylabel=HERTZ, xlim=(0, right), ylim=(0, edges(frequency)[-1]))
    return figure


def wavevector_map(spectra: xr.Dataset, dispersion: xr.Dataset | None = None, name: str = "w") -> Figure:
    """Draw the spectrum E(kx, ky) of z or w at up to three frequencies, with the linear dispersion relation.

    A wave propagates in the direction of (kx, ky).

    Parameters
    ----------
    spectra : Dataset
        Group ``/spectra`` of a wave store.
    dispersion : Dataset, optional
        Group ``/dispersion``, for the circle on which waves that follow the relation lie.
    name : str, default "w"
        Variable of which the spectrum is drawn.

    Returns
    -------
    Figure
    """
    energy = spectra["E_kxky"].sel(quantity_map=name).transpose("omega_map", "ky", "kx")
    omegas = energy.omega_map.values
    kx, ky = energy.kx.values / (2 * np.pi), energy.ky.values / (2 * np.pi)
    chosen = np.unique(np.linspace(0, len(omegas) - 1, min(3, len(omegas))).round().astype(int))
    label = f"E$^{name}$(k, ω) ({_units(name).replace('m)⁻¹', 'm)⁻²')})"
    figure, axes = panels(len(chosen), width=4.7, height=4.2)
    for ax, i in zip(axes[0], chosen, strict=True):
        top = float(np.nanmax(energy.values[i])) or 1.0
        ax.set_facecolor(_LOWEST_COLOUR)
        draw_cells(ax, kx, ky, positive(energy.values[i]), label, LogNorm(top * 1e-5, top), "viridis")
        half = np.abs(kx).max()
        radius = np.nan
        if dispersion is not None and "omega_theory" in dispersion:
            theory = dispersion.omega_theory.values
            radius = np.interp(omegas[i], theory, cycles(dispersion), left=np.nan, right=np.nan)
        if np.isfinite(radius):
            turn = np.linspace(0, 2 * np.pi, 181)
            ax.plot(radius * np.cos(turn), radius * np.sin(turn), color="white", linewidth=0.9, dashes=(4, 3))
            half = min(3.5 * radius, half)
        ax.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
        ax.set(xlabel="kx / 2π (m⁻¹)", ylabel="ky / 2π (m⁻¹)", title=f"{omegas[i] / (2 * np.pi):.2f} Hz")
    return figure


def elevation_spectra(spectra: xr.Dataset) -> Figure:
    """Draw the frequency spectrum of the elevation by each method: probes, z, integrated w, and combinations.

    Lines are thin and pale at frequencies that the store marks as not valid. The band is the 95 % confidence
    interval of the spectrum of z.

    Parameters
    ----------
    spectra : Dataset
        Group ``/spectra`` of a wave store.

    Returns
    -------
    Figure
    """
    figure, [[ax]] = panels(1, width=7.6, height=4.8)
    frequency = hertz(spectra)
    peak = 0.0
    for style, (source, label) in zip(LINES, _METHODS.items(), strict=False):
        if source == "probes":
            if "Ez_probes" not in spectra:
                continue
            values, good = spectra.Ez_probes.values, spectra.valid_probes.values
        else:
            values, good = (spectra[name].sel(source=source).values for name in ("Ez", "valid_Ez"))
        draw_curves(ax, frequency, {label: values}, (style,), log="xy", valid=good)
        peak = max(peak, float(np.nan_to_num(values[good]).max(initial=0.0)))
        if source == "stereo":
            interval = [spectra[end].sel(source=source).values * values for end in ("low_Ez", "high_Ez")]
            ax.fill_between(frequency, *interval, color=style["color"], alpha=0.15, linewidth=0)
            finite = interval[1][(frequency > 0) & np.isfinite(interval[1])]
            peak = max(peak, float(finite.max(initial=0.0)) / 3)
    if peak > 0:
        ax.set_ylim(peak * 1e-9, peak * 5)
    if (frequency > 0).any():
        ax.set_xlim(frequency[frequency > 0][0], frequency[-1])
    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    finish(ax, HERTZ, "E$^z$(ω) (m² s rad⁻¹)")
    return figure


def wavenumber_spectra(spectra: xr.Dataset) -> Figure:
    """Draw the spectra E(k) and E(omega) of z_t, u, v, w and the nonlinear term (u - U) . grad z.

    z_t is the rate of rise of the surface, and U the mean current.

    Parameters
    ----------
    spectra : Dataset
        Group ``/spectra`` of a wave store.

    Returns
    -------
    Figure
    """
    figure, axes = panels(2)
    labels = {"z_t": "z_t", "u": "u", "v": "v", "w": "w", "nl": "(u − U)·∇z"}
    for ax, x, name, xlabel, ylabel in (
        (axes[0, 0], cycles(spectra), "E_k", CYCLES, "E(k) (m³ s⁻² rad⁻¹)"),
        (axes[0, 1], hertz(spectra), "E_omega", HERTZ, "E(ω) (m² s⁻¹ rad⁻¹)"),
    ):
        energy = spectra[name].sel(quantity=list(labels))
        draw_curves(ax, x, dict(zip(labels.values(), energy.values, strict=True)), log="xy")
        top = float(energy.max())
        if top > 0:
            ax.set_ylim(top * 1e-11, top * 5)
        finish(ax, xlabel, ylabel)
    return figure


def dispersion_ridge(dispersion: xr.Dataset) -> Figure:
    """Draw measured points of the dispersion relation, and their deviation from linear theory.

    Parameters
    ----------
    dispersion : Dataset
        Group ``/dispersion`` of a wave store.

    Returns
    -------
    Figure
    """
    figure, [[left, right]] = panels(2)
    k, measured = cycles(dispersion), dispersion.ridge_k.values / (2 * np.pi)
    frequency = dispersion.ridge_omega.values / (2 * np.pi)
    left.scatter(measured, frequency, s=5, color=LINES[1]["color"], label="measured points")
    theory = dispersion.omega_theory.values / (2 * np.pi)
    left.plot(k, theory, label="linear theory", **LINES[0])
    reach = 1.3 * float(np.nanmax(measured)) if measured.size else k[-1]
    highest = float(np.interp(reach, k, theory))
    finish(left, CYCLES, HERTZ, xlim=(0, reach), ylim=(0, 1.1 * highest))
    right.axhline(0, color="0.3", linewidth=0.8)
    right.plot(dispersion.band_frequency.values, 100 * dispersion.ridge_error.values, marker="o", **LINES[1])
    finish(right, HERTZ, "measured k against theory (%)")
    return figure


def directions(direction: xr.Dataset) -> Figure:
    """Draw the density of wave energy over direction at up to four frequencies, and isotropy over frequency.

    Parameters
    ----------
    direction : Dataset
        Group ``/direction`` of a wave store.

    Returns
    -------
    Figure
    """
    figure, [[left, right]] = panels(2)
    known = direction.D.dropna("frequency").transpose("frequency", "theta")
    chosen = known[np.unique(np.linspace(0, len(known) - 1, 4).astype(int))] if len(known) else known
    curves = {f"{float(one.frequency):.2f} Hz": one.values for one in chosen}
    draw_curves(left, np.degrees(direction.theta.values), curves, LINES[1:])
    left.axhline(1 / (2 * np.pi), color="0.3", linewidth=0.8)
    finish(left, "direction of travel (degrees from x)", "density (rad⁻¹)", ylim=(0, None))
    right.plot(direction.frequency.values, direction.isotropy.values, **LINES[1])
    finish(right, HERTZ, "isotropy (1: no direction is preferred)", ylim=(0, 1.05))
    return figure


def probe_series(compared: xr.Dataset) -> Figure:
    """Draw the elevation over time by wave probes, and by the cameras at the same positions.

    Parameters
    ----------
    compared : Dataset, (probe, time)
        ``elevation`` by the probes and ``z`` of the cube at the same positions, each minus its mean (m); and
        by probe, ``rms_difference`` (m) and ``correlation``. Only the middle of a long record is drawn.

    Returns
    -------
    Figure
    """
    count, steps = compared.sizes["probe"], compared.sizes["time"]
    first = max(0, (steps - _STEPS_DRAWN) // 2)
    part = compared.isel(time=slice(first, first + _STEPS_DRAWN))
    figure, axes = panels(1, count, width=7.6, height=4.8 if count == 1 else 5.4 / count)
    for k, ax in enumerate(axes[:, 0]):
        one = part.isel(probe=k)
        curves = {"wave probe": 100 * one.elevation.values, "cameras": 100 * one.z.values}
        draw_curves(ax, part.time.values, curves, (LINES[0], LINES[2]))
        title = (
            f"{one.probe.item()}: rms difference {1e3 * float(one.rms_difference):.2g} mm, "
            f"correlation {min(float(one.correlation), 0.9999):.4f}"
        )
        finish(ax, "time (s)" if k == count - 1 else "", "elevation (cm)")
        ax.set_title(title, loc="left", fontsize=10)
        ax.get_legend().remove()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, frameon=False, fontsize=9)
    return figure


def bicoherence_map(higher_order: xr.Dataset) -> Figure:
    """Draw bicoherence and tricoherence, grey below the level that random phases exceed in 5 % of cases.

    Parameters
    ----------
    higher_order : Dataset
        Group ``/higher_order`` of a wave store.

    Returns
    -------
    Figure
    """
    names = [name for name in ("bicoherence", "tricoherence") if name in higher_order]
    figure, axes = panels(len(names))
    first, second = (higher_order[d].values / (2 * np.pi) for d in ("omega1", "omega2"))
    for ax, name in zip(axes[0], names, strict=True):
        values = higher_order[name].transpose("omega1", "omega2").values
        level = np.asarray(higher_order[f"{name}_level"].values, float)
        ax.set_facecolor("0.92")
        above = np.where(values > level, values, np.nan)
        draw_cells(ax, second, first, above, f"{name} (1)", Normalize(0, 1), POSITIVE)
        ax.set(xlabel="ω₂ / 2π (Hz)", ylabel="ω₁ / 2π (Hz)", title=f"{name}, grey: chance", aspect="equal")
    return figure


def crest_curves(crests: xr.Dataset) -> Figure:
    """Draw the fraction of crests and of troughs beyond each level, with the laws of Rayleigh and Tayfun.

    Parameters
    ----------
    crests : Dataset
        The result of `wavefield.crest_statistics`.

    Returns
    -------
    Figure
    """
    figure, [[ax]] = panels(1, width=5.6)
    level = crests.level.values
    for style, name in zip(LINES[1:], ("crest", "trough"), strict=False):
        part, std = crests[f"{name}_exceedance"].values, crests[f"{name}_exceedance_std"].values
        some = part > 0
        ax.semilogy(level[some], part[some], label=f"{name}s", **style)
        low = np.maximum(part - 2 * std, part / 20)
        ax.fill_between(level[some], low[some], (part + 2 * std)[some], color=style["color"], alpha=0.2)
    for dash, name in (("--", "rayleigh"), (":", "tayfun")):
        ax.semilogy(level, crests[name].values, color="0.35", linestyle=dash, label=name.capitalize())
    smallest = 0.3 / max(float(crests["waves"]), 10.0)
    finish(ax, "level (standard deviations)", "fraction beyond it", ylim=(smallest, 1.5))
    return figure


def flatness_curves(structure: xr.Dataset) -> Figure:
    """Draw the mean square (second-order structure function) and flatness of increments over lag in t, x, y.

    Parameters
    ----------
    structure : Dataset
        The result of `wavefield.structure_functions`.

    Returns
    -------
    Figure
    """
    figure, axes = panels(2, rows=2, height=3.4)
    for column, (unit, names) in enumerate((("s", ("time",)), ("m", ("x", "y")))):
        above, below = axes[0, column], axes[1, column]
        for style, name in zip(LINES[1:], names):
            lag = structure[f"lag_{name}"].values
            second = structure[f"structure_{name}"].sel(order=2).values
            above.loglog(lag, second, label=f"along {name}", **style)
            flat, std = structure[f"flatness_{name}"].values, structure[f"flatness_{name}_std"].values
            below.semilogx(lag, flat, label=f"along {name}", **style)
            below.fill_between(lag, flat - 2 * std, flat + 2 * std, color=style["color"], alpha=0.2)
        below.axhline(3, color="0.35", linestyle="--", label="Gaussian field")
        for ax in (above, below):
            ax.xaxis.set_minor_formatter(NullFormatter())
        finish(above, "", "S₂, the mean squared increment")
        finish(below, f"lag ({unit})", "flatness S₄ / S₂²")
    return figure
