"""The section on errors in a report: misfits of a cube, differences between pairs of cameras, true errors."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wavefield import figures
from wavefield.figures.style import LINES, finish, panels
from wavefield.pipeline import Run
from wavefield.reports.html import Item, Picture, ReportSection, Table, Text
from wavefield.reports.numbers import number, rms_of, thinned
from wavefield.rig.field import pixel_size

_STD_UNITS = (("z_std", "mm"), ("u_std", "mm/s"), ("v_std", "mm/s"), ("w_std", "mm/s"))


def accuracy(run: Run) -> ReportSection:
    """Return the section on misfits, standard uncertainties, and differences between pairs of cameras.
    For a simulated experiment it also shows the errors, relative to the exact fields."""
    compared = ", errors against the exact fields" if run.truth is not None else ""
    gist = f"misfits, standard uncertainties, pairs of cameras{compared}"
    items = [*_internal(run.cube), *pair_items(run), *_against_truth(run)]
    return ReportSection("Accuracy", items, folded=True, gist=gist)


def _internal(cube: xr.Dataset) -> list[Item]:
    part = thinned(cube, "eps_y", "eps_piv")
    medians = ", ".join(
        f"{name} {1e3 * float(thinned(cube, name)[name].median()):.2g} {unit}" for name, unit in _STD_UNITS
    )
    return [
        Picture(
            figures.misfit_maps(part),
            "Rms in time of the epipolar error of the cameras (eps_y) and of the misfit of their "
            "displacements (eps'). A constant pattern points to the calibration, a slope to a camera that "
            "has moved.",
            f"Maps of eps_y, rms {1e3 * rms_of(part.eps_y):.3g} mm, and of eps', rms "
            f"{rms_of(part.eps_piv):.3g} px.",
        ),
        Picture(
            figures.uncertainty_maps(cube),
            "Standard uncertainties, median in time.",
            f"Maps of the median uncertainty: {medians}.",
        ),
    ]


def _against_truth(run: Run) -> list[Item]:
    if run.truth is None or run.rig is None:
        return []
    errors, pixel = errors_against(run.cube, run.truth), pixel_size(run.rig, run.grid)
    rate = float(run.cube.attrs["frame_rate"])
    rms = ", ".join(f"{n} {rms_of(errors[n]) / (pixel if n == 'z' else rate * pixel):.3f} px" for n in "zuvw")
    return [
        Picture(
            figures.error_distributions(errors, pixel),
            "Against the exact fields of the simulated experiment, all nodes: errors of z and of the "
            "displacements in one step.",
            f"Densities of the errors. Rms: {rms}.",
        ),
    ]


def errors_against(cube: xr.Dataset, truth: xr.Dataset) -> xr.Dataset:
    """Return measured minus exact fields.

    Parameters
    ----------
    cube, truth : Dataset, (time, y, x)
        Measured and exact fields. Nodes are matched to within 1 nm, steps to within 1 us.

    Returns
    -------
    Dataset, (time, y, x)
        Errors of z (m) and u, v, w (m s-1), loaded, at the nodes and steps that both datasets have.
    """

    def keyed(data: xr.Dataset) -> xr.Dataset:
        out = data[["z", "u", "v", "w"]]
        return out.assign_coords(time=out.time.round(6), x=out.x.round(9), y=out.y.round(9))

    measured, exact = xr.align(keyed(cube), keyed(truth), join="inner")
    return (measured - exact).load().assign_attrs(frame_rate=cube.attrs["frame_rate"])


# -- pairs of cameras against one another: errors without exact fields ---------------------------------------

# by quantity: name in the table, factor by which its rms is multiplied, value in Aubourg et al. (2019)
_NAMES = {
    "eps_y": ("epipolar error (eps_y), {}", 1.0, "0.04 to 0.08 cm"),
    "sigma_z": ("σ of z that follows, {}", 1.0, "0.048 to 0.058 cm"),
    "z": ("(z {} − z {}) / √2", 0.5**0.5, "0.057 cm"),
    "z_recombined": ("z {} recombined − direct", 1.0, ""),
    "eps_piv": ("displacements differ (eps'), {}", 1.0, "0.34 to 0.37 px"),
    "dx": ("(dx {} − dx {}) / √2", 0.5**0.5, "0.3 px"),
    "dy": ("(dy {} − dy {}) / √2", 0.5**0.5, "0.3 px"),
    "dz": ("(dz {} − dz {}) / √2", 0.5**0.5, "0.3 px"),
}


def pair_items(run: Run) -> list[Item]:
    """Return pictures and a table of the errors of each pair of cameras, or a text on why they are absent."""
    found = run.pair_statistics
    if found is None:
        return [Text(f"Pairs of cameras are not compared: {run.reason('pair_statistics')}.")]
    steps, pixel = len(np.atleast_1d(found.attrs["steps"])), float(found.attrs["pixel_size"])
    rows, spread = pair_rows(found), "at one step" if steps == 1 else f"at {steps} steps over the record"
    own = ", ".join(f"{name} {px}" for name, _, px, *_ in rows)
    items: list[Item] = [
        Picture(
            pair_misfits(found),
            f"Distributions of eps_y and of eps' for each pair of cameras on its own, {spread}, before "
            "outliers are rejected. They are wider than in the cube, which combines all pairs.",
            f"Densities of eps_y and of eps' for each pair. Rms: {own}.",
        )
    ]
    if "z" in found.quantity:
        items.append(
            Picture(
                pair_differences(found),
                "Differences between the measurements of the pairs, each on its own (divided by √2 they are "
                "errors of one pair), and between z recombined from two pairs and z of the direct one.",
                "Densities of the differences; their rms is in the table.",
            )
        )
    caption = (
        "Pairs of cameras alone, before outliers are rejected: rms of the errors within three times the rms, "
        f"and the fraction beyond; 1 px is {1e3 * pixel:.2g} mm"
    )
    return [*items, Table(caption, ("error", "cm", "px", "beyond", "paper"), rows)]


def pair_rows(found: xr.Dataset) -> list[tuple[str, ...]]:
    """Return a table row for each quantity and pair of cameras in `found`, from `Run.pair_statistics`.
    Columns: error; its rms, cm and px; percentage above three times the rms; rms by Aubourg et al. (2019)."""
    rows: list[tuple[str, ...]] = []
    for k in range(found.sizes["error"]):
        error = found.isel(error=k)
        name, factor, published = _NAMES[str(error.quantity.item())]
        rms = factor * float(error.rms)
        in_px = str(error.units.item()) == "pixel"
        px = rms if in_px else rms / float(found.attrs["pixel_size"])
        single = str(error.quantity.item()) == "sigma_z"
        beyond = "" if single else f"{100 * float(error.beyond):.1f} %"
        cameras = str(error.cameras.item()).split(" minus ")
        cm = "" if in_px else f"{100 * rms:.2g}"
        rows.append((name.format(*cameras), cm, f"{px:.2g}", beyond, published))
    return rows


def _draw(axes: Axes, found: xr.Dataset, quantities: tuple[str, ...], factor: float, label: str) -> None:
    """Draw the probability densities of errors of `quantities`, a line per pair of cameras.
    `found` is `Run.pair_statistics`; `factor` converts its errors to the unit in `label`: "eps_y mm"."""
    symbol, unit = label.rsplit(" ", 1)
    errors = found.isel(error=np.isin(found.quantity, quantities))
    for k in range(errors.sizes["error"]):
        error = errors.isel(error=k)
        rms, name = factor * float(error.rms), str(error.cameras.item())
        if "z_recombined" == error.quantity:
            name += " recombined minus direct"
        density = np.where(error.density > 0, error.density / rms, np.nan)
        style = LINES[1 + k % (len(LINES) - 1)]
        axes.semilogy(rms * error.bin, density, label=f"{name}, rms {number(rms, digits=2)} {unit}", **style)
    finish(axes, f"{symbol} ({unit})", f"probability density ({unit}⁻¹)", columns=1)


def pair_misfits(found: xr.Dataset) -> Figure:
    """Draw the distributions of epipolar error (eps_y) and displacement misfit (eps') of each camera pair.
    `found` is the result of `Run.pair_statistics`."""
    figure, axes = panels(2, height=4.6)
    _draw(axes[0, 0], found, ("eps_y",), 1e3, "eps_y mm")
    _draw(axes[0, 1], found, ("eps_piv",), 1.0, "eps' px")
    axes[0, 1].set_xlim(left=0)
    return figure


def pair_differences(found: xr.Dataset) -> Figure:
    """Draw the distributions of the differences, in px, between z, dx, dy and dz of one pair of cameras and
    another. A second curve is z from the matches of two pairs that share a camera, less z of the third pair.
    `found` is `Run.pair_statistics`."""
    per_metre = 1.0 / float(found.attrs["pixel_size"])
    kinds = [("z", "z_recombined"), ("dx",), ("dy",), ("dz",)]
    kinds = [names for names in kinds if np.isin(found.quantity, names).any()]
    figure, axes = panels(min(len(kinds), 2), -(-len(kinds) // 2), height=4.8)
    for ax, names in zip(axes.ravel(), kinds):
        _draw(ax, found, names, per_metre, f"difference of {names[0]} px")
    return figure
