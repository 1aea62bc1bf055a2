"""Spectra, the nonlinear term and coherence."""

import numpy as np

from wavefield import figures
from wavefield.reports.html_page import Picture, ReportSection, Text
from wavefield.reports.number_text import median_of, number, rms_of
from wavefield.reports.sources import Sources
from wavefield.waves.nonlinear.kinematics import kinematics_at


def spectra(sources: Sources) -> ReportSection:
    """Build the part on spectra."""
    group, dispersion = sources.group("spectra"), sources.group("dispersion")
    section = ReportSection("Spectra")
    if group is None:
        return section
    values = group.E_komega_w.values
    positive = values[values > 0]
    decades = float(np.log10(positive.max() / np.median(positive))) if positive.size else 0.0
    section.items += [Text(note) for note in sources.waves_notes.splitlines() if note]
    share = (
        ""
        if dispersion is None or "ridge_fraction" not in dispersion
        else (f" {100 * float(dispersion.ridge_fraction):.0f} % of the variance of w lies on the ridge.")
    )
    section.items += [
        Picture(
            figures.komega_map(group, dispersion),
            "Spectrum of the vertical velocity in wavenumber and frequency, on a logarithmic colour scale, "
            "with the "
            "linear dispersion relation.",
            f"Map of E(k, omega). Its peak stands {decades:.1f} decades above the median.{share}",
        ),
        Picture(
            figures.wavevector_map(group, dispersion),
            "The same at chosen frequencies over the direction of travel; the dashed circle is the "
            "dispersion relation.",
            "Maps of E(kx, ky) at up to three frequencies with the circle of the dispersion relation.",
        ),
        Picture(
            figures.wavenumber_spectra(group),
            "Spectra in wavenumber and in frequency.",
            "Curves of E(k) and E(omega) of z_t, u, v, w and of the nonlinear term, on logarithmic axes.",
        ),
    ]
    if dispersion is not None and "ridge_k" in dispersion:
        typical = number(median_of(100 * np.abs(dispersion.ridge_error.values)), "%", 2)
        section.items.append(
            Picture(
                figures.dispersion_ridge(dispersion),
                "The ridge measured in the spectrum of w, and how far it is from linear theory.",
                f"The ridge over theory. Its median deviation by bands is {typical}.",
            )
        )
    direction = sources.group("direction")
    if direction is not None:
        section.items.append(
            Picture(
                figures.directions(direction),
                "Directions of the waves on the ridge, and how isotropic the sea is at each frequency.",
                "Directional densities at chosen frequencies; isotropy against frequency, median "
                f"{float(direction.isotropy.median()):.2f}.",
            )
        )
    higher = sources.group("higher_order")
    if higher is not None and "bicoherence" in higher:
        section.items.append(
            Picture(
                figures.bicoherence_map(higher),
                "Three- and four-wave coherence above what phase-randomised surrogates give in 5 % of cases.",
                "Maps of bicoherence and tricoherence; largest bicoherence "
                f"{float(higher.bicoherence.max()):.2f}.",
            )
        )
    return section


def nonlinearity(sources: Sources) -> ReportSection:
    """Build the part on the kinematic condition."""
    snap = sources.snapshot()
    terms = kinematics_at(snap, sources.cube)
    rms = {name: 100 * rms_of(terms[name]) for name in ("nonlinear", "residual")}
    section = ReportSection(
        "Nonlinear term and coherence",
        [
            Picture(
                figures.kinematics_maps(snap, sources.cube),
                "Elevation, vertical velocity, the nonlinear term u·∇z, and what is left of z_t − w + "
                "u·∇z, at one "
                "moment; the last two share one colour scale.",
                f"Four maps. Rms of w {100 * rms_of(snap.w):.3g} cm/s, of the nonlinear term "
                f"{rms['nonlinear']:.3g} "
                f"cm/s, of the residual {rms['residual']:.3g} cm/s.",
            )
        ],
    )
    coherence = sources.group("coherence")
    if coherence is not None:
        total = np.abs(coherence.C_tot.values)
        section.items.append(
            Picture(
                figures.coherence_curves(coherence),
                "Coherence of the rate of rise with w, with the nonlinear term, and with their sum: with the "
                "common normalisation of the paper (left) and the standard one with its level of chance "
                "(right).",
                f"Curves against wavenumber. The coherence with the sum is {float(np.nanmax(total)):.3f} "
                f"at most; that "
                f"with the nonlinear term reaches {float(np.nanmax(np.abs(coherence.C_nl.values))):.3f}.",
            )
        )
    kinematics = sources.group("kinematics")
    if kinematics is not None:
        section.items.append(
            Picture(
                figures.balance_history(kinematics),
                "Course of the terms of the kinematic condition.",
                "Curves of the rms of w, of the nonlinear term and of the residual against time; residual "
                "over "
                f"nonlinear term {100 * float(kinematics.residual_fraction):.0f} %.",
            )
        )
    return section
