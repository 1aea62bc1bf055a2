"""Section on errors: internal, of pairs of cameras, of the spectra, and against the truth."""

import xarray as xr

from wavefield import figures
from wavefield.pipeline import Run
from wavefield.reports.elevation_section import noise_pictures
from wavefield.reports.html_page import Item, Picture, ReportSection
from wavefield.reports.number_text import rms_of
from wavefield.reports.pair_section import pair_items
from wavefield.reports.run_data import thinned
from wavefield.rig.resolution import pixel_size

_STD_UNITS = (("z_std", "mm"), ("u_std", "mm/s"), ("v_std", "mm/s"), ("w_std", "mm/s"))


def accuracy(run: Run) -> ReportSection:
    """Errors: internal, between pairs of cameras, of the spectra, against the truth where it is known."""
    items = [*_internal(run.cube), *pair_items(run), *noise_pictures(run), *_against_truth(run)]
    shown = "misfits, standard uncertainties, pairs of cameras"
    compared = ", errors against the exact fields" if run.truth is not None else ""
    return ReportSection("Accuracy", items, folded=True, gist=f"{shown}{compared}")


def _internal(cube: xr.Dataset) -> list[Item]:
    part = thinned(cube, "eps_y", "eps_piv")
    medians = ", ".join(
        f"{name} {1e3 * float(thinned(cube, name)[name].median()):.2g} {unit}" for name, unit in _STD_UNITS
    )
    return [
        Picture(
            figures.misfit_distributions(part),
            "Distributions of the mismatch of the cameras' sight lines (eps_y) and of the misfit of their "
            "displacements (eps') in the measured nodes: errors that the measurement itself shows.",
            f"Densities. Rms of eps_y {1e3 * rms_of(part.eps_y):.3g} mm, of eps' {rms_of(part.eps_piv):.3g} "
            "px (published for a similar rig: 0.4 to 0.8 mm, 0.34 to 0.37 px).",
        ),
        Picture(
            figures.misfit_maps(part),
            "Maps of these errors. A pattern that is constant in time points to the calibration; a camera "
            "that has moved shows as a slope.",
            "Maps of the rms in time of eps_y and of eps'.",
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
        Picture(figures.error_maps(errors, pixel), "Maps of these errors.", "Maps of the rms of z and dz."),
    ]


def errors_against(cube: xr.Dataset, truth: xr.Dataset) -> xr.Dataset:
    """Measured minus exact.

    Parameters
    ----------
    cube, truth : Dataset, (time, y, x)
        Measured and exact, on the same nodes and times (to a nanometre and a microsecond).

    Returns
    -------
    Dataset
        z (m), u, v, w (m s-1), loaded; steps that are in one only are left out.
    """

    def keyed(data: xr.Dataset) -> xr.Dataset:
        out = data[["z", "u", "v", "w"]]
        return out.assign_coords(time=out.time.round(6), x=out.x.round(9), y=out.y.round(9))

    measured, exact = xr.align(keyed(cube), keyed(truth), join="inner")
    return (measured - exact).load().assign_attrs(frame_rate=cube.attrs["frame_rate"])
