"""Every figure and number of the paper on one page, from one cube, its waves and a still-water record."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

from wavefield import figures
from wavefield.atomic_write import Product, check_writable, write_text
from wavefield.errors import StoreError
from wavefield.pipeline import Run
from wavefield.reports.accuracy import pair_items
from wavefield.reports.compose import build_all, experiment_name, measured_run, page_of
from wavefield.reports.fields import distribution_picture, elevation_pictures, setup, snapshot_pictures
from wavefield.reports.html import Head, Item, Picture, ReportSection, Table, Text, render
from wavefield.reports.numbers import number, rms_of, snapshot, thinned
from wavefield.reports.waves import (
    coherence_picture,
    kinematics_picture,
    nonlinear_ratio_picture,
    spectrum_pictures,
)
from wavefield.rig.field import pixel_size
from wavefield.store.read import find_store, open_cube
from wavefield.store.recipe import source_of
from wavefield.waves import plane_coherence

_METHODS = {"stereo": "stereo z", "w": "integrated w", "cross": "cross-spectrum", "fusion": "fusion"}


def paper(
    store: str | Path,
    output: str | Path | None = None,
    *,
    rest: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write the figures and numbers of the paper for one experiment as one HTML file that opens offline.

    Parameters
    ----------
    store : path
        Cube written by `run`.
    output : path, optional
        File to write; by default ``..._paper.html`` next to the cube.
    rest : path, optional
        Cube of still water, by the same cameras; without it there is no figure of still water.
    progress : callable, optional
        Called with (sections drawn, all sections).

    Returns
    -------
    Path
        The file.

    Raises
    ------
    StoreError
        If a cube or its waves are not there, or the file cannot be written.

    Examples
    --------
    >>> import wavefield as wf
    >>> page = wf.paper("cube.zarr", "paper.html", rest="rest.zarr")  # doctest: +SKIP
    >>> page.name  # doctest: +SKIP
    'paper.html'
    """
    output = Path(output) if output is not None else page_of(store, "paper")
    path = find_store(store)
    check_writable(output, _product(open_cube(path)), inputs=[path])
    still = None if rest is None else measured_run(rest).cube
    return _write(measured_run(path), still, output, progress)


def _write(
    run: Run, still: xr.Dataset | None, output: Path, progress: Callable[[int, int], None] | None
) -> Path:
    builders: list[Callable[[], ReportSection]] = [
        partial(build, run)
        for build in (_setup, _snapshot, _distributions, _spectrum, _nonlinear, _elevation)
    ]
    builders += [partial(_still_water, run, still), partial(_pairs, run), partial(_numbers, run, still)]
    head = Head(
        f"{experiment_name(run)}: the paper's figures",
        (f"The figures of Aubourg et al. for {run.cube.sizes['time']} steps",),
    )
    write_text(output, render(head, build_all(builders, progress)), _product(run.cube))
    return output


def _product(cube: xr.Dataset) -> Product:
    return Product("paper page", source_of(cube))


def _group(run: Run, name: str) -> xr.Dataset:
    group = run.wave_group(name)
    if group is None:
        why = run.reason("waves") or f"the wave store has no group {name!r}: run `wavefield analyze` again"
        raise StoreError(why)
    return group


def _pixel(run: Run) -> float:
    return pixel_size(run.rig, run.grid) if run.rig is not None else float("nan")


def _setup(run: Run) -> ReportSection:
    section = setup(run)
    if not section.items:
        section.items.append(Text(f"No cameras are drawn: {run.reason('rig')}."))
    return section


def _snapshot(run: Run) -> ReportSection:
    return ReportSection("Surface and velocity", snapshot_pictures(snapshot(run.cube)))


def _distributions(run: Run) -> ReportSection:
    part, rate = thinned(run.cube, "z", "u", "v", "w"), float(run.cube.attrs["frame_rate"])
    rows = []
    for name, label, scale in (("z", "z", 100.0), *((n, f"d{a}", 100 / rate) for n, a in zip("uvw", "xyz"))):
        values = scale * part[name]
        rows.append((label, number(float(values.std())), number(float(np.abs(values).max()))))
    table = Table("Standard deviation and largest magnitude, cm", ("", "σ", "largest"), rows)
    return ReportSection("Distributions", [distribution_picture(part, rate), table])


def _spectrum(run: Run) -> ReportSection:
    pictures = spectrum_pictures(_group(run, "spectra"), run.wave_group("dispersion"))
    return ReportSection("Spectrum of the vertical velocity", pictures)


def _nonlinear(run: Run) -> ReportSection:
    snap, cube = snapshot(run.cube), run.cube
    plane = plane_coherence(cube)
    low_k = float(plane.mean_C.sel(term="tot")[: plane.sizes["k"] // 4].mean())
    return ReportSection(
        "Nonlinear term",
        [
            kinematics_picture(snap, cube),
            Picture(
                figures.plane_coherence_maps(plane),
                "Coherence at each wave vector, averaged over time; and the three curves averaged over angle "
                "after the ratio, as in the paper.",
                "Map of the coherence over kx, ky, and curves over k; with the sum it is on average "
                f"{low_k:.3f} over the lowest quarter of k.",
            ),
            coherence_picture(_group(run, "coherence")),
            nonlinear_ratio_picture(_group(run, "kinematics")),
        ],
    )


def _elevation(run: Run) -> ReportSection:
    fusion = _group(run, "fusion")
    rows = []
    for method in fusion.source.values:
        reach = fusion.sel(source=method)
        decades = number(float(reach.range_decades), digits=2)
        name = _METHODS.get(str(method), str(method))
        rows.append((name, decades, number(float(reach.range_frequency), "Hz", 2)))
    table = Table("Correct within a factor 2", ("method", "decades below the peak", "up to"), rows)
    return ReportSection("Spectrum of the elevation", [*elevation_pictures(run), table])


def _still_water(run: Run, still: xr.Dataset | None) -> ReportSection:
    section = ReportSection("Still water")
    if still is None:
        section.items.append(Text("No still-water record was given (--rest): the paper's figure needs one."))
        return section
    fields = still[["z", "u", "v", "w"]].load().assign_attrs(still.attrs)
    rate, pixel = float(still.attrs["frame_rate"]), _pixel(run)
    z, about_mean = rms_of(fields.z), rms_of(fields.z - fields.z.mean("time"))
    sizes = {"z − z_rest": z, "z − ⟨z⟩ − z_rest": about_mean}
    sizes |= {f"d{axis}": rms_of(fields[name]) / rate for axis, name in zip("xyz", "uvw")}
    rows = [(name, number(100 * v, "cm", 2), number(v / pixel, "px", 2)) for name, v in sizes.items()]
    section.items += [
        Picture(
            figures.rest_distributions(fields),
            "z − z_rest, with and without each node's mean over time, and the displacements, which should be "
            "zero.",
            f"Densities. Rms of z {1e3 * z:.2g} mm, about the mean {1e3 * about_mean:.2g} mm.",
        ),
        Table(f"Rms over {still.sizes['time']} steps of still water", ("", "", ""), rows),
    ]
    return section


def _pairs(run: Run) -> ReportSection:
    items: list[Item] = [item for item in pair_items(run) if not isinstance(item, Table)]
    return ReportSection("Pairs of cameras against one another", items)


def _numbers(run: Run, still: xr.Dataset | None) -> ReportSection:
    rows: list[tuple[str, str, str]] = []
    if still is not None:
        z = still.z.load()
        without_means = rms_of(z - z.mean("time"))
        rows.append(("z of still water, rms", "0.07 cm", number(100 * rms_of(z), "cm", 2)))
        rows.append(("the same without means over time", "0.05 cm", number(100 * without_means, "cm", 2)))
    if run.pair_statistics is not None:
        rows += _pair_numbers(run.pair_statistics)
    dispersion = run.wave_group("dispersion")
    if dispersion is not None and "ridge_error" in dispersion:
        largest = number(100 * float(np.abs(dispersion.ridge_error).max()), "% of k", 2)
        rows.append(("deviation from the linear dispersion relation, largest", "to 5 Hz by eye", largest))
    kinetic = run.wave_group("kinematics")
    if kinetic is not None:
        fraction = number(100 * float(kinetic.nonlinear_fraction), "%", 2)
        rows.append(("u·∇η over w, rms", "about 10 %", fraction))
    caption, pixel = "Numbers of the paper and of this experiment", _pixel(run)
    if np.isfinite(pixel):
        caption += f"; 1 px is {1e3 * pixel:.2g} mm"
    return ReportSection("Numbers", [Table(caption, ("", "paper", "here"), rows)])


def _pair_numbers(found: xr.Dataset) -> list[tuple[str, str, str]]:
    """The rms of the errors of the pairs, next to those of the paper."""
    published = {
        "eps_y": ("eps_Y, pair {}", "0.04 to 0.08 cm", 100.0, "cm"),
        "sigma_z": ("σ_z from it, pair {}", "0.048 to 0.058 cm", 100.0, "cm"),
        "z": ("z {}, over √2", "0.057 cm", 100.0 / 2**0.5, "cm"),
        "eps_piv": ("eps', cameras {}", "0.34 to 0.37 px", 1.0, "px"),
    }
    rows = []
    for quantity, (name, paper_value, factor, unit) in published.items():
        for k in np.flatnonzero(found.quantity.values == quantity):
            error = found.isel(error=k)
            cameras = str(error.cameras.item()).replace(" minus ", " − ")
            rows.append((name.format(cameras), paper_value, number(factor * float(error.rms_all), unit, 2)))
    return rows
