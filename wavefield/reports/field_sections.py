"""Sections on the surface and its velocity, their distributions, coverage, and the cameras over time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wavefield import figures
from wavefield.figures.style import LINES, RIGHT, panels
from wavefield.pipeline import Run
from wavefield.reports.html_page import Item, Listing, Picture, ReportSection, Table
from wavefield.reports.number_text import median_of, number
from wavefield.reports.run_data import extremes_of, thinned
from wavefield.store.ledger import status
from wavefield.store.verdict import Numbers, Verdict
from wavefield.variables import FrameStatus

_MAX_FAULTS = 500  # listed
_MARKERS = "os^Dv*"
# numbers of cameras and of pairs that are drawn over time: name, factor, label
_HISTORIES = (
    (
        ("blur", 1, "width of the finest\ndetails (px)"),
        ("brightness", 1, "mean brightness\n(grey levels)"),
        ("coverage", 100, "free view (%)"),
    ),
    (("agreement", 100, "patches matched (%)"), ("eps_y", 1, "sight lines miss\nby (px)")),
)


def snapshot_pictures(snap: xr.Dataset) -> list[Item]:
    """The surface and its velocity at one step (y, x)."""
    ranges = extremes_of(snap)
    return [
        Picture(
            figures.surface_3d(snap),
            "The surface at one moment; heights are exaggerated, colour is the vertical velocity.",
            f"Three-dimensional view of the surface. {ranges}",
        ),
        Picture(
            figures.velocity_map(snap),
            "Velocity of the surface water at the same moment: w in colour, u and v as arrows.",
            f"Map of the vertical velocity with arrows of the horizontal velocity. {ranges}",
        ),
    ]


def distribution_picture(part: xr.Dataset, rate: float) -> Picture:
    """Distributions of z, u, v, w (time, y, x) measured so many times per second."""
    stds = [f"z {100 * float(part.z.std()):.3g} cm"]
    stds += [f"d{axis} {100 / rate * float(part[n].std()):.3g} cm" for axis, n in zip("xyz", "uvw")]
    return Picture(
        figures.distributions(part),
        "Probability densities of the elevation and of the displacements in one step, with Gaussians of the "
        "same standard deviation.",
        f"Densities on a logarithmic scale. Standard deviations: {', '.join(stds)}.",
    )


def distributions(run: Run) -> ReportSection:
    """Distributions of the fields and their moments."""
    part = thinned(run.cube, "z", "u", "v", "w")
    picture = distribution_picture(part, float(run.cube.attrs["frame_rate"]))
    section = ReportSection("Distributions", [picture], folded=True)
    statistics = run.wave_group("statistics")
    if statistics is not None and "skewness" in statistics:
        rows = []
        for quantity in statistics.quantity.values:
            moments = statistics.sel(quantity=quantity)
            values = 100 * float(moments["std"]), float(moments.skewness), float(moments.kurtosis)
            rows.append((str(quantity), *map(number, values)))
        section.gist = f"skewness of z {rows[0][2]}, excess kurtosis {rows[0][3]}"
        head = ("quantity", "std (cm)", "skewness", "excess kurtosis")
        section.items.append(Table("Moments, over the rectangle and the steps of the spectra", head, rows))
    return section


def coverage(run: Run) -> ReportSection:
    """Where and when the surface was measured, and which steps have faults."""
    cube = run.cube
    step_status = cube.frame_status.values
    faulty = np.flatnonzero(step_status != int(FrameStatus.DONE))
    gist = f"{faulty.size or 'none'} of {step_status.size} steps have faults"
    section = ReportSection("Coverage and faults", folded=True, gist=gist)
    section.items += [
        Picture(
            figures.coverage_map(cube),
            "Fraction of time in which each node was measured, and in which it was filled from its "
            "neighbours.",
            "Two maps in percent.",
        ),
        Picture(
            figures.fault_history(cube),
            "Measured, filled and rejected fractions of the nodes in view over time, and the status of each "
            "step.",
            f"Curves in percent over time; {faulty.size} of {step_status.size} steps have faults.",
        ),
    ]
    if faulty.size:
        lines = [
            f"step {i}, t = {float(cube.time[i]):.4g} s: "
            f"{FrameStatus(int(step_status[i])).name.lower().replace('_', ' ')}"
            for i in faulty[:_MAX_FAULTS]
        ]
        if faulty.size > _MAX_FAULTS:
            lines.append(f"... and {faulty.size - _MAX_FAULTS} more")
        section.items.append(Listing(f"The {faulty.size} steps with faults", "\n".join(lines)))
    bad_frames = [str(bad) for bad in status(run.store).bad_frames] if run.store.is_dir() else []
    if bad_frames:
        section.items.append(Listing("Frames that were missing or bad", "\n".join(bad_frames)))
    return section


def cameras_over_time(run: Run, verdict: Verdict) -> ReportSection:
    """Every camera and pair at some instants of the record, as the run checked them."""
    section = ReportSection("Cameras over time", folded=True)
    if not verdict.cameras or not verdict.frames:
        return section
    section.gist = f"sharpness, brightness, free view and consistency at {len(verdict.frames)} instants"
    rate = float(run.cube.attrs["frame_rate"])
    time = float(run.cube.time[0]) + (np.array(verdict.frames) - 0.5) / rate
    each = "; ".join(
        f"{name}: details of {number(median_of(c['blur']), 'px', 2)}, brightness "
        f"{number(median_of(c['brightness']))}, at least {100 * np.nanmin(c['coverage']):.0f} % in view"
        for name, c in verdict.cameras.items()
    )
    section.items.append(
        Picture(
            _camera_history(time, verdict.cameras, verdict.pairs),
            f"Every camera at {len(time)} instants of the record: details that become wider show a loss of "
            "focus, decreasing brightness a loss of light; what is missing from 100 % of the view is "
            "covered. Below, each pair of cameras alone, before anything is rejected: sight lines that miss "
            "each other more and more show that a camera has been moved.",
            f"Curves. {each}.",
        )
    )
    return section


def _camera_history(time: np.ndarray, cameras: Numbers, pairs: Numbers) -> Figure:
    """Sharpness, brightness and free view of every camera, consistency of every pair, over the record."""
    figure, axes = panels(3, 2 if pairs else 1, width=3.8, height=2.9)
    for row, numbers, histories in zip(axes, (cameras, pairs), _HISTORIES):
        for ax, (key, factor, label) in zip(row, histories):
            curves = {name: [factor * v for v in series[key]] for name, series in numbers.items()}
            _draw_history(ax, time, curves, label)
    style: dict[str, Any] = {"frameon": False, "fontsize": 9, "alignment": "left"}
    if not pairs:
        axes[0, 2].legend(**style, **RIGHT)
        return figure
    free = axes[1, 2]
    free.set_axis_off()
    above, below = (ax.get_legend_handles_labels() for ax in axes[:, 0])
    free.add_artist(free.legend(*above, loc="upper left", title="above", **style))
    free.legend(*below, loc="upper right", title="below", **style)
    return figure


def _draw_history(axes: Axes, time: np.ndarray, curves: Mapping[str, Sequence[float]], label: str) -> None:
    for k, (name, values) in enumerate(curves.items()):
        style = LINES[1 + k % (len(LINES) - 1)]
        axes.plot(time, values, marker=_MARKERS[k % len(_MARKERS)], markersize=4, label=name, **style)
    most = max((float(np.nanmax(v)) for v in curves.values() if np.isfinite(v).any()), default=1.0)
    axes.set(xlabel="time (s)", ylabel=label, ylim=(0.0, 1.12 * most or 1.0))
    axes.grid(True, color="0.88", linewidth=0.7)
