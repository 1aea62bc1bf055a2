"""The surface and its velocity, their distributions, and where they were measured."""

from typing import Any

import numpy as np

from wavefield import figures
from wavefield.figures.style import moment_title
from wavefield.reports.html_page import Listing, Markup, Picture, ReportSection, Table
from wavefield.reports.number_text import number
from wavefield.reports.player import markup
from wavefield.reports.sources import Sources
from wavefield.variables import FrameStatus


def surface(sources: Sources) -> ReportSection:
    """Build the part on the surface and its velocity."""
    snap = sources.snapshot()
    z, w = 100 * snap.z, 100 * snap.w
    numbers = (
        f"At {moment_title(snap)} z runs from {float(z.min()):.2g} to {float(z.max()):.2g} cm and "
        f"w from "
        f"{float(w.min()):.2g} to {float(w.max()):.2g} cm/s."
    )
    return ReportSection(
        "Surface and velocity",
        [
            Markup(markup(sources.cube)),
            Picture(
                figures.surface_3d(snap),
                "The surface at one moment; heights are exaggerated, colour is the vertical velocity.",
                f"Three-dimensional view of the surface. {numbers}",
            ),
            Picture(
                figures.velocity_map(snap),
                "Velocity of the surface water at the same moment: w in colour, u and v as arrows.",
                f"Map of the vertical velocity with arrows of the horizontal velocity. {numbers}",
            ),
        ],
    )


def distributions(sources: Sources) -> ReportSection:
    """Build the part on distributions."""
    part = sources.thinned("z", "u", "v", "w")
    rate = float(sources.cube.attrs["frame_rate"])
    spread = ", ".join(
        f"d{a} {100 / rate * float(part[n].std()):.3g} cm" for a, n in zip("xyz", "uvw", strict=True)
    )
    items: list[Any] = [
        Picture(
            figures.distributions(part),
            "Probability densities of the elevation and of the displacements in one step, beside the "
            "Gaussian of the "
            "same spread.",
            f"Densities on a logarithmic scale. Standard deviations: z {100 * float(part.z.std()):.3g} cm, "
            f"{spread}.",
        )
    ]
    statistics = sources.group("statistics")
    if statistics is not None and "skewness" in statistics:
        items.append(
            Table(
                "Moments, over the rectangle and the steps of the spectra",
                ("quantity", "std (cm)", "skewness", "excess kurtosis"),
                [
                    (
                        str(q),
                        number(100 * float(statistics["std"].sel(quantity=q))),
                        number(float(statistics.skewness.sel(quantity=q))),
                        number(float(statistics.kurtosis.sel(quantity=q))),
                    )
                    for q in statistics.quantity.values
                ],
            )
        )
    return ReportSection("Distributions", items)


def coverage(sources: Sources) -> ReportSection:
    """Build the part on coverage and faults."""
    cube = sources.cube
    status = cube.frame_status.values
    faulty = np.flatnonzero(status != int(FrameStatus.DONE))
    section = ReportSection(
        "Coverage and faults",
        [
            Picture(
                figures.coverage_map(cube),
                "Fraction of time in which each node was measured, and in which it was filled from its "
                "neighbours.",
                "Two maps in percent.",
            ),
            Picture(
                figures.fault_history(cube),
                "Course of the measured, filled and rejected fractions of the nodes in view, and how each "
                "step ended.",
                f"Curves in percent against time; {faulty.size} of {status.size} steps are not simply done.",
            ),
        ],
    )
    if faulty.size:
        lines = [
            f"step {i}, t = {float(cube.time[i]):.4g} s: "
            f"{FrameStatus(int(status[i])).name.lower().replace('_', ' ')}"
            for i in faulty[:500]
        ]
        if faulty.size > 500:
            lines.append(f"... and {faulty.size - 500} more")
        section.items.append(Listing(f"The {faulty.size} steps with faults", "\n".join(lines)))
    if sources.bad_frames:
        section.items.append(Listing("Frames that were missing or bad", "\n".join(sources.bad_frames)))
    return section
