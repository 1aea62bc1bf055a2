"""Spectra of a wave store (`wavefield analyze`): in wavenumber and frequency, and in frequency alone."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from wavefield.figures.style import LINES, POSITIVE, colour_bar, edges, panels, plain_axes
from wavefield.water import GRAVITY

_METHODS = {
    "Ez_probes": "wave probes",
    "Ez_stereo": "stereo z",
    "Ez_w": "integrated w",
    "Ez_cross": "cross-spectrum of z and w",
    "Ez_fusion": "fusion of z and w",
}


def _units(name: str) -> str:
    """Of E(k, omega): of the variable squared, per wavenumber and frequency."""
    return f"{'m²' if name == 'z' else 'm² s⁻²'} (rad/m)⁻¹ (rad/s)⁻¹"


def komega_map(spectra: xr.Dataset, dispersion: xr.Dataset | None = None, name: str = "w") -> Figure:
    """E(k, omega) in colour, with the dispersion relation.

    Parameters
    ----------
    spectra : Dataset
        Group ``/spectra`` of a wave store.
    dispersion : Dataset, optional
        Group ``/dispersion``, for the theoretical curve.
    name : str, default "w"
        Which variable.

    Returns
    -------
    Figure

    Notes
    -----
    Counterpart of the paper's space-time spectrum of w.
    """
    energy = spectra[f"E_komega_{name}"].transpose("omega", "k")
    hertz, cycles = energy.omega.values / (2 * np.pi), energy.k.values / (2 * np.pi)
    values = np.where(energy.values > 0, energy.values, np.nan)
    top = float(np.nanmax(values)) if np.isfinite(values).any() else 1.0
    figure, axes = panels(1, width=7.2, height=4.8)
    ax = axes[0, 0]
    mesh = ax.pcolormesh(
        edges(cycles),
        edges(hertz),
        np.ma.masked_invalid(values),
        norm=LogNorm(top * 1e-7, top),
        cmap="viridis",
        rasterized=True,
    )
    ax.set_facecolor("#440154")  # the lowest colour: below the scale is not missing
    colour_bar(ax, mesh, f"E$^{name}$(k, ω) ({_units(name)})")
    if dispersion is not None and "omega_theory" in dispersion:
        k = dispersion.k.values / (2 * np.pi)
        curve = dispersion.omega_theory.values / (2 * np.pi)
        ax.plot(k, curve, color="white", linewidth=2.6)
        ax.plot(k, curve, color="black", linewidth=1.3, label="linear dispersion relation")
        plain = np.sqrt(GRAVITY * dispersion.k.values) / (2 * np.pi)
        ax.plot(k, plain, color="white", linewidth=1.0, linestyle="--", label="ω = √(gk)")
        ax.legend(loc="lower right", fontsize=9, framealpha=0.9, facecolor="0.6")
    ax.set(xlabel="k / 2π (m⁻¹)", ylabel="ω / 2π (Hz)")
    right = edges(cycles)[-1]
    if dispersion is not None and "omega_theory" in dispersion:  # beyond, waves are too fast for the frames
        fastest = np.interp(2 * np.pi * hertz[-1], dispersion.omega_theory.values, dispersion.k.values)
        right = min(right, 1.25 * float(fastest) / (2 * np.pi))
    ax.set(xlim=(0, right), ylim=(0, edges(hertz)[-1]))
    return figure


def wavevector_map(spectra: xr.Dataset, dispersion: xr.Dataset | None = None, name: str = "w") -> Figure:
    """E(kx, ky) at chosen frequencies, with the circle of the dispersion relation.

    Parameters
    ----------
    spectra : Dataset
        Group ``/spectra`` of a wave store.
    dispersion : Dataset, optional
        Group ``/dispersion``, for the circle.
    name : str, default "w"
        Which variable.

    Returns
    -------
    Figure

    Notes
    -----
    Counterpart of the paper's map at 2.8 Hz. A wave is drawn where it goes.
    """
    energy = spectra[f"E_kxky_{name}"].transpose("omega_map", "ky", "kx")
    omegas = energy.omega_map.values
    chosen = np.unique(np.linspace(0, len(omegas) - 1, min(3, len(omegas))).round().astype(int))
    figure, axes = panels(len(chosen), width=4.7, height=4.2)
    for ax, i in zip(axes[0], chosen, strict=True):
        values = energy.values[i]
        top = float(np.nanmax(values)) or 1.0
        kx, ky = energy.kx.values / (2 * np.pi), energy.ky.values / (2 * np.pi)
        mesh = ax.pcolormesh(
            edges(kx),
            edges(ky),
            np.ma.masked_invalid(np.where(values > 0, values, np.nan)),
            norm=LogNorm(top * 1e-5, top),
            cmap="viridis",
            rasterized=True,
        )
        ax.set_facecolor("#440154")
        colour_bar(ax, mesh, f"E$^{name}$(k, ω) ({_units(name).replace('m)⁻¹', 'm)⁻²')})")
        radius = _radius(dispersion, omegas[i])
        if radius:
            turn = np.linspace(0, 2 * np.pi, 181)
            ax.plot(radius * np.cos(turn), radius * np.sin(turn), color="white", linewidth=0.9, dashes=(4, 3))
        half = min(3.5 * radius, np.abs(kx).max()) if radius else np.abs(kx).max()
        ax.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
        ax.set(xlabel="kx / 2π (m⁻¹)", ylabel="ky / 2π (m⁻¹)", title=f"{omegas[i] / (2 * np.pi):.2f} Hz")
    return figure


def _radius(dispersion: xr.Dataset | None, omega: float) -> float | None:
    """Wavenumber on the dispersion relation, cycles per metre."""
    if dispersion is None or "omega_theory" not in dispersion:
        return None
    theory = dispersion.omega_theory.values
    if not theory.min() <= omega <= theory.max():
        return None
    return float(np.interp(omega, theory, dispersion.k.values) / (2 * np.pi))


def elevation_spectra(spectra: xr.Dataset) -> Figure:
    """E^z(omega) by each method: probes, stereo, integrated w, cross-spectrum, fusion.

    Parameters
    ----------
    spectra : Dataset
        Group ``/spectra`` of a wave store.

    Returns
    -------
    Figure

    Notes
    -----
    Counterpart of the paper's temporal spectrum. Lines are thin and pale where the store marks them as not
    valid; the band is the 95 % interval of the stereo spectrum.
    """
    figure, axes = panels(1, width=7.6, height=4.8)
    ax = axes[0, 0]
    hertz = spectra.omega.values / (2 * np.pi)
    peak = 0.0
    for style, (name, label) in zip(LINES, _METHODS.items(), strict=False):
        if name not in spectra:
            continue
        values = spectra[name].values
        method = name.removeprefix("Ez_")
        valid = (
            spectra[f"valid_{method}"].values if f"valid_{method}" in spectra else np.ones(hertz.size, bool)
        )
        drawn = np.where(values > 0, values, np.nan)
        ax.loglog(hertz, drawn, color=style["color"], linewidth=0.7, alpha=0.5)
        ax.loglog(hertz, np.where(valid, drawn, np.nan), label=label, **style)
        if valid.any():
            peak = max(peak, float(np.nanmax(np.where(valid, drawn, 0.0))))
        if method == "stereo":
            _draw_interval(ax, spectra, method, hertz, drawn)
    ax.set(xlabel="ω / 2π (Hz)", ylabel="E$^z$(ω) (m² s rad⁻¹)")
    if peak > 0:
        ax.set_ylim(peak * 1e-9, peak * 5)
    positive = hertz[hertz > 0]
    if positive.size:
        ax.set_xlim(positive[0], positive[-1])
    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    plain_axes(ax, loc="lower left")
    return figure


def _draw_interval(ax: Axes, spectra: xr.Dataset, method: str, hertz: np.ndarray, values: np.ndarray) -> None:
    if f"low_{method}" in spectra and f"high_{method}" in spectra:
        low, high = spectra[f"low_{method}"].values * values, spectra[f"high_{method}"].values * values
        ax.fill_between(hertz, low, high, color=LINES[1]["color"], alpha=0.15, linewidth=0)


def wavenumber_spectra(spectra: xr.Dataset) -> Figure:
    """E(k) and E(omega) of the measured variables.

    Parameters
    ----------
    spectra : Dataset
        Group ``/spectra`` of a wave store.

    Returns
    -------
    Figure
    """
    figure, axes = panels(2)
    labels = {"z_t": "z_t", "u": "u", "v": "v", "w": "w", "nl": "u·∇z"}
    for ax, dim, prefix, axis in (
        (axes[0, 0], "k", "E_k_", "k / 2π (m⁻¹)"),
        (axes[0, 1], "omega", "E_", "ω / 2π (Hz)"),
    ):
        for style, (name, label) in zip(LINES, labels.items(), strict=False):
            if prefix + name in spectra:
                values = spectra[prefix + name].values
                ax.loglog(
                    spectra[dim].values / (2 * np.pi),
                    np.where(values > 0, values, np.nan),
                    label=label,
                    **style,
                )
        tops = [float(spectra[prefix + n].max()) for n in labels if prefix + n in spectra]
        if tops and max(tops) > 0:
            ax.set_ylim(max(tops) * 1e-11, max(tops) * 5)
        unit = "m³ s⁻² rad⁻¹" if dim == "k" else "m² s⁻¹ rad⁻¹"
        ax.set(xlabel=axis, ylabel=f"E({'k' if dim == 'k' else 'ω'}) ({unit})")
        plain_axes(ax)
    return figure


def noise_spectra(spectra: xr.Dataset, fusion: xr.Dataset) -> Figure:
    """Noise of the stereo elevation and of the integrated w, and the weight of each in the fusion.

    Parameters
    ----------
    spectra : Dataset
        Group ``/spectra`` of a wave store.
    fusion : Dataset
        Group ``/fusion``.

    Returns
    -------
    Figure
    """
    figure, axes = panels(2)
    left, right = axes[0]
    hertz = fusion.omega.values / (2 * np.pi)

    def draw(values: xr.DataArray, label: str, style: dict[str, Any]) -> None:
        left.loglog(hertz, np.where(values.values > 0, values.values, np.nan), label=label, **style)

    draw(spectra.Ez_fusion, "elevation (fusion)", LINES[0])
    draw(fusion.noise_z, "noise of stereo z", LINES[1])
    draw(fusion.noise_w, "noise of integrated w", LINES[2])
    left.set(xlabel="ω / 2π (Hz)", ylabel="spectral density (m² s rad⁻¹)")
    peak = float(np.nanmax(spectra.Ez_fusion.values))
    if peak > 0:
        left.set_ylim(peak * 1e-9, peak * 5)
    right.semilogx(hertz, 100 * fusion.weight_z.values, label="stereo z", **LINES[1])
    right.semilogx(hertz, 100 * (1 - fusion.weight_z.values), label="integrated w", **LINES[2])
    right.set(xlabel="ω / 2π (Hz)", ylabel="weight in the fusion (%)", ylim=(-3, 103))
    for ax in axes[0]:
        plain_axes(ax)
    return figure


def dispersion_ridge(dispersion: xr.Dataset) -> Figure:
    """The measured ridge against the dispersion relation.

    Parameters
    ----------
    dispersion : Dataset
        Group ``/dispersion`` of a wave store.

    Returns
    -------
    Figure
    """
    figure, axes = panels(2)
    left, right = axes[0]
    left.scatter(
        dispersion.ridge_k.values / (2 * np.pi),
        dispersion.ridge_omega.values / (2 * np.pi),
        s=5,
        color=LINES[1]["color"],
        label="measured ridge",
    )
    k = dispersion.k.values / (2 * np.pi)
    left.plot(k, dispersion.omega_theory.values / (2 * np.pi), label="linear theory", **LINES[0])
    if "omega_fit" in dispersion:
        left.plot(k, dispersion.omega_fit.values / (2 * np.pi), label="fitted surface tension", **LINES[2])
    reach = (
        1.3 * float(np.nanmax(dispersion.ridge_k.values)) / (2 * np.pi) if dispersion.ridge_k.size else k[-1]
    )
    highest = float(np.interp(reach, k, dispersion.omega_theory.values)) / (2 * np.pi)
    left.set(xlabel="k / 2π (m⁻¹)", ylabel="ω / 2π (Hz)", xlim=(0, reach), ylim=(0, 1.1 * highest))
    right.axhline(0, color="0.3", linewidth=0.8)
    right.plot(dispersion.band_frequency.values, 100 * dispersion.ridge_error.values, marker="o", **LINES[1])
    right.set(xlabel="ω / 2π (Hz)", ylabel="ridge against theory (%)")
    for ax in axes[0]:
        plain_axes(ax)
    return figure


def directions(direction: xr.Dataset) -> Figure:
    """Directional density of the waves at chosen frequencies, and isotropy against frequency.

    Parameters
    ----------
    direction : Dataset
        Group ``/direction`` of a wave store.

    Returns
    -------
    Figure
    """
    figure, axes = panels(2)
    left, right = axes[0]
    omegas = direction.omega_map.values
    for i, style in zip(range(len(omegas)), LINES[1:], strict=False):
        left.plot(
            np.degrees(direction.theta.values),
            direction.D.isel(omega_map=i).values,
            label=f"{omegas[i] / (2 * np.pi):.2f} Hz",
            **style,
        )
    left.axhline(1 / (2 * np.pi), color="0.3", linewidth=0.8)
    left.set(xlabel="direction of travel (degrees from x)", ylabel="density (rad⁻¹)", ylim=(0, None))
    right.plot(direction.omega.values / (2 * np.pi), direction.isotropy.values, **LINES[1])
    right.set(xlabel="ω / 2π (Hz)", ylabel="isotropy (1: no direction is preferred)", ylim=(0, 1.05))
    for ax in axes[0]:
        plain_axes(ax)
    return figure


def bicoherence_map(higher_order: xr.Dataset) -> Figure:
    """Bicoherence above the level of chance.

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
    for ax, name in zip(axes[0], names, strict=True):
        values = higher_order[name].transpose("omega1", "omega2").values
        level = np.asarray(higher_order[f"{name}_level"].values, float)
        shown = np.where(values > level, values, np.nan)
        first, second = (higher_order[d].values / (2 * np.pi) for d in ("omega1", "omega2"))
        ax.set_facecolor("0.92")
        mesh = ax.pcolormesh(
            edges(second),
            edges(first),
            np.ma.masked_invalid(shown),
            vmin=0,
            vmax=1,
            cmap=POSITIVE,
            rasterized=True,
        )
        colour_bar(ax, mesh, f"{name} (1)", "neither")
        ax.set(xlabel="ω₂ / 2π (Hz)", ylabel="ω₁ / 2π (Hz)", title=f"{name}, grey: chance", aspect="equal")
    return figure
