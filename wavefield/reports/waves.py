"""Sections of a report: spectra of the waves; kinematic boundary condition of the surface and coherence."""

import numpy as np
import xarray as xr

from wavefield import figures
from wavefield.pipeline import Run
from wavefield.reports.html import Item, Picture, ReportSection, Text
from wavefield.reports.numbers import median_of, number, rms_of, snapshot
from wavefield.waves.motion import kinematics_at


def spectrum_pictures(group: xr.Dataset, dispersion: xr.Dataset | None) -> list[Item]:
    """Return pictures of E(k, omega) and E(kx, ky) of w; `group` is `/spectra` of a wave store."""
    energy = group.E.sel(quantity="w").values
    positive = energy[energy > 0]
    decades = float(np.log10(positive.max() / np.median(positive))) if positive.size else 0.0
    share = f" {_on_relation(dispersion)}." if _on_relation(dispersion) else ""
    return [
        Picture(
            figures.komega_map(group, dispersion),
            "Spectrum of the vertical velocity over wavenumber and frequency, on a logarithmic colour scale, "
            "with the linear dispersion relation.",
            f"Map of E(k, omega). Its peak is {decades:.1f} decades above the median.{share}",
        ),
        Picture(
            figures.wavevector_map(group, dispersion),
            "The same at chosen frequencies over the direction of travel; the dashed circle is the "
            "dispersion relation.",
            "Maps of E(kx, ky) at up to three frequencies with the circle of the dispersion relation.",
        ),
    ]


def _on_relation(dispersion: xr.Dataset | None) -> str:
    """Return a phrase with the percentage of the variance of w on the dispersion relation; "" if unknown."""
    if dispersion is None or "ridge_fraction" not in dispersion:
        return ""
    percent = 100 * float(dispersion.ridge_fraction)
    return f"{percent:.0f} % of the variance of w follows the dispersion relation"


def spectra(run: Run) -> ReportSection:
    """Return the section on the spectra that `wavefield analyze` wrote; it is empty if there are none."""
    section = ReportSection("Spectra", folded=True)
    group, dispersion = run.wave_group("spectra"), run.wave_group("dispersion")
    if run.waves is None or group is None:
        return section
    section.items += [Text(note) for note in str(run.waves.attrs.get("notes", "")).splitlines() if note]
    section.items += spectrum_pictures(group, dispersion)
    section.gist = "over wavenumber, frequency and direction"
    if share := _on_relation(dispersion):
        section.gist += f"; {share}"
    section.items.append(
        Picture(
            figures.wavenumber_spectra(group),
            "Spectra over wavenumber and over frequency.",
            "Curves of E(k) and E(omega) of z_t, u, v, w and of the nonlinear term, on logarithmic axes.",
        )
    )
    if dispersion is not None and "ridge_k" in dispersion:
        deviation = number(median_of(100 * np.abs(dispersion.ridge_error.values)), "%", 2)
        section.items.append(
            Picture(
                figures.dispersion_ridge(dispersion),
                "The dispersion relation in the spectrum of w, and its deviation from linear theory.",
                f"Measured wavenumber over theory. The median deviation of the bands is {deviation}.",
            )
        )
    direction = run.wave_group("direction")
    if direction is not None:
        section.items.append(
            Picture(
                figures.directions(direction),
                "Directions of the waves of the dispersion relation, and the isotropy at each frequency.",
                "Directional densities at chosen frequencies; isotropy over frequency, median "
                f"{float(direction.isotropy.median()):.2f}.",
            )
        )
    higher = run.wave_group("higher_order")
    if higher is not None and "bicoherence" in higher:
        section.items.append(
            Picture(
                figures.bicoherence_map(higher),
                "Three- and four-wave coherence above the level that phase-randomised surrogates exceed in "
                "5 % of cases.",
                "Maps of bicoherence and tricoherence; largest bicoherence "
                f"{float(higher.bicoherence.max()):.2f}.",
            )
        )
    return section


def kinematics_picture(snap: xr.Dataset) -> Picture:
    """Return a picture of z, w, u . grad z and the residual z_t - w + u . grad z at one step (y, x)."""
    terms = kinematics_at(snap)
    return Picture(
        figures.kinematics_maps(snap),
        "Elevation, vertical velocity, the nonlinear term u·∇z, and the residual z_t − w + u·∇z, at one "
        "moment; the last two share one colour scale.",
        f"Four maps. Rms of w {100 * rms_of(snap.w):.3g} cm/s, of the nonlinear term "
        f"{100 * rms_of(terms.nonlinear):.3g} cm/s, of the residual {100 * rms_of(terms.residual):.3g} cm/s.",
    )


def coherence_picture(coherence: xr.Dataset) -> Picture:
    """Return a picture of the coherence of z_t with w, with -u . grad z, and with the sum of these two.
    They are relative to the mean current. `coherence` is the group `/coherence` of a wave store."""
    valid = coherence.where(coherence["valid"]) if "valid" in coherence else coherence
    total, nonlinear = (median_of(np.abs(valid.C.sel(term=term).values)) for term in ("tot", "nl"))
    return Picture(
        figures.coherence_curves(coherence),
        "Coherence of the rate of rise with w, with the nonlinear term, and with their sum: with the common "
        "normalisation of the paper (left) and the standard one with its level of chance (right); thin where "
        "the spectra are not reliable.",
        f"Curves over wavenumber. Where the spectra are reliable, the median coherence with the sum is "
        f"{number(total)}, that with the nonlinear term {number(nonlinear)}.",
    )


def nonlinear_ratio_picture(kinematics: xr.Dataset) -> Picture:
    """Return a picture of the ratio of (u - U) . grad z to w, with the mean current U.
    `kinematics` is the group `/kinematics` of a wave store."""
    ratio = kinematics.nonlinear_ratio_k
    return Picture(
        figures.nonlinear_ratio_curves(kinematics),
        "Ratio of the nonlinear term, relative to the mean current, to the vertical velocity over wavenumber "
        "and frequency, with 95 % intervals.",
        f"Two curves. Over wavenumber the median is {100 * median_of(ratio.values):.2g} %.",
    )


def nonlinearity(run: Run) -> ReportSection:
    """Return the section on the kinematic boundary condition z_t = w - u . grad z, and on coherence."""
    maps = kinematics_picture(snapshot(run.cube))
    section = ReportSection("Nonlinear term and coherence", [maps], folded=True)
    coherence, kinematics = run.wave_group("coherence"), run.wave_group("kinematics")
    if coherence is not None:
        section.items.append(coherence_picture(coherence))
    if kinematics is not None and "nonlinear_ratio_k" in kinematics:
        section.items.append(nonlinear_ratio_picture(kinematics))
    if kinematics is not None:
        share = 100 * float(kinematics.residual_fraction)
        section.gist = f"residual over nonlinear term {share:.0f} %"
    return section
