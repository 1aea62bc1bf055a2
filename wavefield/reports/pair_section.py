"""Pairs of cameras against one another: errors without any truth, from the statistics in the cube."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wavefield.figures.style import LINES, panels, plain_axes
from wavefield.pipeline import Run
from wavefield.reports.html_page import Item, Picture, Table, Text
from wavefield.reports.number_text import number

# quantity: its name in a table, factor of its rms there
_NAMES = {
    "eps_y": ("sight lines miss (eps_y), {}", 1.0),
    "sigma_z": ("σ of z that follows, {}", 1.0),
    "z": ("(z {} − z {}) / √2", 0.5**0.5),
    "z_recombined": ("z {} recombined − direct", 1.0),
    "eps_piv": ("displacements differ (eps'), {}", 1.0),
    "dx": ("(dx {} − dx {}) / √2", 0.5**0.5),
    "dy": ("(dy {} − dy {}) / √2", 0.5**0.5),
    "dz": ("(dz {} − dz {}) / √2", 0.5**0.5),
}


def pair_items(run: Run) -> list[Item]:
    """Pictures and table of the errors of each pair, or a note why there are none."""
    found = run.pair_statistics
    if found is None:
        return [Text(f"Pairs of cameras are not compared: {run.reason('pair_statistics')}.")]
    steps, pixel = len(np.atleast_1d(found.attrs["steps"])), float(found.attrs["pixel_size"])
    rows = pair_rows(found)
    own = ", ".join(f"{name} {px}" for name, _, px, _ in rows)
    items: list[Item] = [
        Picture(
            pair_misfits(found),
            f"The same for each pair of cameras on its own, at {steps} steps spread over the record, before "
            "anything is rejected: wider than the errors in a cube, which are those of all pairs together.",
            f"Densities of eps_y and of eps' for each pair. Rms: {own}.",
        )
    ]
    if "z" in found.quantity:
        items.append(
            Picture(
                pair_differences(found),
                "Differences between the measurements of the pairs, each on its own (divided by √2 they are "
                "errors of one pair; published: 0.3 px), and between z recombined from two pairs and z of "
                "the direct one.",
                "Densities of differences of z, dx, dy, dz; their rms is in the table.",
            )
        )
    caption = (
        "Pairs of cameras alone, before anything is rejected: rms of the errors within three times the rms, "
        f"and the fraction beyond; 1 px is {1e3 * pixel:.2g} mm"
    )
    return [*items, Table(caption, ("error", "cm", "px", "beyond"), rows)]


def pair_rows(found: xr.Dataset) -> list[tuple[str, str, str, str]]:
    """Name, rms in cm and in px, and the fraction beyond three times the rms, of every error."""
    rows = []
    for k in range(found.sizes["error"]):
        error = found.isel(error=k)
        name, factor = _NAMES[str(error.quantity.item())]
        rms = factor * float(error.rms)
        in_px = str(error.units.item()) == "pixel"
        px = rms if in_px else rms / float(found.attrs["pixel_size"])
        single = str(error.quantity.item()) == "sigma_z"
        beyond = "" if single else f"{100 * float(error.beyond):.1f} %"
        cameras = str(error.cameras.item()).split(" minus ")
        rows.append((name.format(*cameras), "" if in_px else f"{100 * rms:.2g}", f"{px:.2g}", beyond))
    return rows


def _draw(axes: Axes, found: xr.Dataset, quantities: tuple[str, ...], factor: float, label: str) -> None:
    """Densities of some errors, in a unit of which there are `factor` per metre or pixel."""
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
    axes.set(xlabel=f"{symbol} ({unit})", ylabel=f"probability density ({unit}⁻¹)")
    plain_axes(axes, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=1)


def pair_misfits(found: xr.Dataset) -> Figure:
    """Distributions of eps_y and of eps' of each pair of cameras on its own.
    Counterpart of the paper's distributions of eps_Y for three pairs and of its PIV errors.
    """
    figure, axes = panels(2, height=4.6)
    _draw(axes[0, 0], found, ("eps_y",), 1e3, "eps_y mm")
    _draw(axes[0, 1], found, ("eps_piv",), 1.0, "eps' px")
    axes[0, 1].set_xlim(left=0)
    return figure


def pair_differences(found: xr.Dataset) -> Figure:
    """Differences between pairs of cameras, px: of z, of dx, of dy, of dz, with each node's mean in time.
    Counterpart of the paper's differences between three pairs, and of two recombined against the direct one.
    """
    per_metre = 1.0 / float(found.attrs["pixel_size"])
    figure, axes = panels(2, 2, height=4.8)
    _draw(axes[0, 0], found, ("z", "z_recombined"), per_metre, "difference of z px")
    for ax, name in zip(axes.flat[1:], ("dx", "dy", "dz")):
        _draw(ax, found, (name,), per_metre, f"difference of {name} px")
    return figure
