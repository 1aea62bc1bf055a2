"""The page that shows the figures and numbers of Aubourg et al. (2019) for the user's experiment."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

from wavefield import figures
from wavefield.atomic_write import Product, check_writable, write_text
from wavefield.errors import StoreError
from wavefield.pipeline import Run
from wavefield.reports.accuracy import pair_items
from wavefield.reports.compose import build_all, experiment_name, measured_run
from wavefield.reports.fields import distributions, elevation, setup, snapshots
from wavefield.reports.html import Head, Picture, ReportSection, Table, Text, render
from wavefield.reports.numbers import number, rms_of
from wavefield.reports.waves import nonlinearity, spectra
from wavefield.rig.field import pixel_size
from wavefield.store import beside
from wavefield.store.cube import open_cube
from wavefield.store.read import find_store
from wavefield.store.recipe import source_of
from wavefield.waves import plane_coherence


def paper(
    store: str | Path,
    output: str | Path | None = None,
    *,
    rest: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Draw the figures of Aubourg et al. (2019) from a cube, and compare its numbers with the published ones.

    Parameters
    ----------
    store : path
        Cube written by `run`.
    output : path, optional
        File to write; by default ``paper.html`` next to ``cube.zarr``, ``a_paper.html`` next to ``a.zarr``.
    rest : path, optional
        Cube of still water from the same cameras; without it the figure of still water is left out.
    progress : callable, optional
        Called with the number of sections drawn and the number of all sections.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    StoreError
        If a cube or its waves do not exist, or if the file cannot be written, for example because `output`
        exists and is not an earlier page.

    Examples
    --------
    >>> import wavefield as wf
    >>> page = wf.paper("cube.zarr", "paper.html", rest="rest.zarr")  # doctest: +SKIP
    >>> page.name  # doctest: +SKIP
    'paper.html'
    """
    path = find_store(store)
    output = Path(output) if output is not None else beside(path, "paper", ".html")
    check_writable(output, _product(open_cube(path)), inputs=[path])
    still = None if rest is None else measured_run(rest).cube
    return _write(measured_run(path), still, output, progress)


def _write(
    run: Run, still: xr.Dataset | None, output: Path, progress: Callable[[int, int], None] | None
) -> Path:
    if run.wave_group("spectra") is None:
        raise StoreError(run.reason("waves") or "the waves have no spectra: run `wavefield analyze` again")
    of_report = (setup, snapshots, distributions, spectra, nonlinearity, _plane_coherence, elevation)
    builders: list[Callable[[], ReportSection]] = [partial(build, run) for build in of_report]
    builders += [partial(_still_water, still), partial(_pairs, run), partial(_numbers, run, still)]
    sections = [replace(section, folded=False) for section in build_all(builders, progress)]
    head = Head(
        f"{experiment_name(run)}: the paper's figures",
        (f"The figures of Aubourg et al. for {run.cube.sizes['time']} steps",),
    )
    write_text(output, render(head, sections), _product(run.cube))
    return output


def _product(cube: xr.Dataset) -> Product:
    return Product("paper page", source_of(cube))


def _plane_coherence(run: Run) -> ReportSection:
    plane = plane_coherence(run.cube)
    low_k = float(plane.mean_C.sel(term="tot")[: plane.sizes["k"] // 4].mean())
    picture = Picture(
        figures.plane_coherence_maps(plane),
        "Coherence at each wave vector, averaged over time; and three curves of the coherence "
        "averaged over the angle, as in the paper.",
        "Map of the coherence over kx, ky, and curves over k; with the sum it is on average "
        f"{low_k:.3f} over the lowest quarter of k.",
    )
    return ReportSection("Coherence over wave vectors", [picture])


def _still_water(still: xr.Dataset | None) -> ReportSection:
    if still is None:
        absent = Text("No still-water record was given (--rest): the paper's figure needs one.")
        return ReportSection("Still water", [absent])
    fields = still[["z", "u", "v", "w"]].load().assign_attrs(still.attrs)
    picture = Picture(
        figures.rest_distributions(fields),
        "z, with and without each node's mean over time, and the displacements, which should be zero.",
        f"Densities over {still.sizes['time']} steps. Rms of z {1e3 * rms_of(fields.z):.2g} mm.",
    )
    return ReportSection("Still water", [picture])


def _pairs(run: Run) -> ReportSection:
    return ReportSection("Pairs of cameras against one another", pair_items(run))


def _numbers(run: Run, still: xr.Dataset | None) -> ReportSection:
    rows: list[tuple[str, str, str]] = []
    if still is not None:
        z = still.z.load()
        without_means = rms_of(z - z.mean("time"))
        rows.append(("z of still water, rms", "0.07 cm", number(100 * rms_of(z), "cm", 2)))
        rows.append(("the same without means over time", "0.05 cm", number(100 * without_means, "cm", 2)))
    dispersion = run.wave_group("dispersion")
    if dispersion is not None and "ridge_error" in dispersion:
        largest = number(100 * float(np.abs(dispersion.ridge_error).max()), "% of k", 2)
        rows.append(("deviation from the linear dispersion relation, largest", "to 5 Hz by eye", largest))
    kinetic = run.wave_group("kinematics")
    if kinetic is not None:
        fraction = number(100 * float(kinetic.nonlinear_fraction), "%", 2)
        rows.append(("u·∇η over w, rms", "about 10 %", fraction))
    caption = "Numbers of the paper and of this experiment"
    if run.rig is not None:
        caption += f"; 1 px is {1e3 * pixel_size(run.rig, run.grid):.2g} mm"
    return ReportSection("Numbers", [Table(caption, ("", "paper", "here"), rows)])
