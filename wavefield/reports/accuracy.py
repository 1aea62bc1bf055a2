"""Errors: internal, between cameras, against probes and the truth; and the calibration."""

import numpy as np
import xarray as xr
import yaml
from numpy.typing import NDArray

from wavefield import figures
from wavefield.errors import ExperimentError
from wavefield.measurement import GridGeometry, Settings
from wavefield.measurement.diagnostics import diagnose_around
from wavefield.reports.html_page import Picture, ReportSection, Table, Text
from wavefield.reports.number_text import number, rms_of
from wavefield.reports.pair_pictures import pair_differences, pair_misfits
from wavefield.reports.sources import Sources
from wavefield.rig.resolution import pixel_size
from wavefield.series.masks import covered_series, footprints


def accuracy(sources: Sources) -> ReportSection:
    """Build the part on errors: internal, against probes, against the truth where it is known."""
    part = sources.thinned("eps_y", "eps_piv")
    section = ReportSection(
        "Accuracy",
        [
            Picture(
                figures.misfit_distributions(part),
                "Distributions of the mismatch of the cameras' sight lines (eps_y) and of the misfit of "
                "their displacements (eps'), of what the run has kept: the measurement's own account of its "
                "errors.",
                f"Densities. Rms of eps_y {1e3 * rms_of(part.eps_y):.3g} mm, of eps' "
                f"{rms_of(part.eps_piv):.3g} px "
                "(published of such a rig: 0.4 to 0.8 mm, 0.34 to 0.37 px).",
            ),
            Picture(
                figures.misfit_maps(part),
                "Where they are large. A pattern that stays in place points to the calibration; a camera "
                "that has "
                "moved shows as a slope.",
                "Maps of the rms in time of eps_y and of eps'.",
            ),
            Picture(
                figures.uncertainty_maps(sources.cube),
                "Standard uncertainties, median in time.",
                "Maps of the median uncertainty: "
                + ", ".join(
                    f"{n} {1e3 * float(sources.thinned(n)[n].median()):.2g} {u}"
                    for n, u in (("z_std", "mm"), ("u_std", "mm/s"), ("v_std", "mm/s"), ("w_std", "mm/s"))
                )
                + ".",
            ),
        ],
    )
    section.items += _pairs(sources)
    group, fusion = sources.group("spectra"), sources.group("fusion")
    if group is not None and "Ez_stereo" in group:
        reach = ""
        if fusion is not None and "range_frequency" in fusion:
            reach = " They reach " + ", ".join(
                f"{r}: {float(fusion.range_frequency.sel(source=r)):.1f} Hz, "
                f"{float(fusion.range_decades.sel(source=r)):.1f} decades"
                for r in fusion.source.values
            )
        section.items.append(
            Picture(
                figures.elevation_spectra(group),
                "Spectrum of the elevation by each method; thin where it is not to be trusted. The band is "
                "the 95 % "
                "interval of the stereo spectrum."
                + ("" if "Ez_probes" in group else " Without wave probes."),
                "Curves on logarithmic axes: "
                + ("probes, " if "Ez_probes" in group else "")
                + f"stereo, integrated w, cross-spectrum, fusion.{reach}",
            )
        )
        if fusion is not None and "noise_z" in fusion:
            section.items.append(
                Picture(
                    figures.noise_spectra(group, fusion),
                    "Noise of the two measurements of the elevation, found without a rest record, and the "
                    "weight of "
                    "each in their best combination.",
                    f"Noise spectra and weights. Noise of z {1e3 * float(fusion.sigma_z):.3g} mm, of dz "
                    f"{1e3 * float(fusion.sigma_dz):.3g} mm.",
                )
            )
    if sources.truth is not None and sources.rig is not None:
        errors = errors_against(sources.cube, sources.truth)
        pixel = pixel_size(sources.rig, sources.grid)
        rate = float(sources.cube.attrs["frame_rate"])
        found = {n: rms_of(errors[n]) / (pixel if n == "z" else rate * pixel) for n in "zuvw"}
        words = ", ".join(f"{n} {v:.3f} px" for n, v in found.items())
        section.items += [
            Picture(
                figures.error_distributions(errors, pixel),
                "Against the exact fields of the simulated experiment, all nodes: errors of z and of the "
                "displacements "
                "in one step.",
                f"Densities of the errors. Rms: {words}.",
            ),
            Picture(
                figures.error_maps(errors, pixel),
                "Where these errors are.",
                "Maps of rms errors of z and dz.",
            ),
        ]
    return section


def _pairs(sources: Sources) -> list[Picture | Table | Text]:
    """Every pair of cameras on its own, if the images are still there."""
    if not sources.frames or sources.rig is None:
        return []
    settings = Settings.from_dict(sources.recipe.get("settings", {}))
    masks = sources.experiment.mask if sources.experiment else {}
    geometry = GridGeometry(sources.rig, sources.grid, settings, footprints(masks))
    pixel = pixel_size(sources.rig, sources.grid)
    series = sources.frames
    if sources.experiment:
        folder = sources.experiment.path.parent
        known = {name: series[name] for name in geometry.cameras}
        try:
            series = covered_series(masks, known, sources.rig, folder, -geometry.z_range[0])
        except ExperimentError as error:
            return [Text(f"Pairs of cameras were not compared: {error}.")]
    steps = min(len(series[name]) for name in geometry.cameras) - 1
    middle = sources.cube.sizes["time"] // 2

    def covered(name: str, frame: int) -> NDArray[np.bool_] | None:
        mask = series[name].mask
        return None if mask is None else mask.covered(frame)

    found = diagnose_around(
        lambda name, frame: series[name].read(frame).image, steps, geometry, None, middle, pixel, covered
    )
    if found is None:
        return []
    steps = len(next(iter(found.z.values())))
    rows = found.table()
    words = ", ".join(f"{row['name']} {row['px']:.2g} px" for row in rows)
    out: list[Picture | Table | Text] = [
        Picture(
            pair_misfits(found),
            f"The same for each pair of cameras on its own, over {steps} steps measured again, before "
            "anything is rejected: wider than what a cube keeps of all pairs together.",
            f"Densities of eps_y and of eps' for each pair. Rms: {words}.",
        )
    ]
    if found.difference:
        out.append(
            Picture(
                pair_differences(found),
                "Differences between what the pairs measure, each on its own (divided by √2 they are errors "
                "of one pair; 0.3 px has been published), and of z recombined from two pairs from z of the "
                "direct one.",
                "Densities of differences of z, dx, dy, dz; their rms is in the table.",
            )
        )
    table = [
        (
            _readable(row["name"]),
            "" if row["cm"] is None else f"{row['cm']:.2g}",
            f"{row['px']:.2g}",
            "" if row["share"] is None else f"{100 * row['share']:.1f} %",
        )
        for row in rows
    ]
    caption = (
        f"Pairs of cameras alone, before anything is rejected: rms of what is within three times the rms, "
        f"and the fraction beyond; 1 px is {1e3 * pixel:.2g} mm"
    )
    return [*out, Table(caption, ("error", "cm", "px", "beyond"), table)]


def _readable(name: str) -> str:
    """A number's name in words, where it stands alone in a table."""
    for short, words in (
        ("eps_y ", "sight lines miss (eps_y), "),
        ("eps' ", "displacements disagree (eps'), "),
        ("sigma_z ", "\u03c3 of z that follows, "),
    ):
        name = name.replace(short, words)
    return name.replace(" / sqrt 2", " / \u221a2").replace(" - ", " \u2212 ")


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


_CALIBRATION = {
    "target": (
        "The target in one image of each camera: nodes found (+), the origin (circle), and where "
        "the rig puts "
        "them on z = 0.",
        "Images of the target with the nodes found in them, and the same nodes in physical coordinates.",
    ),
    "rig": ("The rig and the poses of the target.", "Drawing of the cameras and of the poses of the target."),
    "coverage": (
        "Where in each image the target was seen.",
        "Map of the nodes of all views in each camera's image.",
    ),
    "flat_target": (
        "z of the flat target's nodes, triangulated by the rig.",
        "Map of z of the flat target's nodes.",
    ),
}


def calibration(sources: Sources) -> ReportSection:
    """Build the part on the calibration, from the report that `wavefield calibrate` left beside the rig."""
    section = ReportSection("Calibration")
    folder = sources.calibration_folder
    if folder is None:
        return section
    numbers = yaml.safe_load((folder / "numbers.yaml").read_text(encoding="utf-8")) or {}
    rows = [
        (
            name,
            str(len(c["views"])),
            number(c["rms_px"], "px"),
            number(c["rms_mm"], "mm"),
            number(c["max_px"], "px"),
        )
        for name, c in (numbers.get("cameras") or {}).items()
    ]
    if rows:
        section.items.append(
            Table(
                "Residuals of the points that were fitted", ("camera", "views", "rms", "rms", "largest"), rows
            )
        )
    flat = ""
    if "flat_target" in numbers:
        flat = f" Rms {numbers['flat_target']['z_rms_mm']:.3g} mm."
    for stem, (caption, alt) in _CALIBRATION.items():
        picture = folder / f"{stem}.png"
        if picture.is_file():
            words = alt + flat if stem == "flat_target" else alt
            section.items.append(Picture(picture.read_bytes(), caption, words))
    for picture in sorted(folder.glob("residuals_*.png")):
        name = picture.stem.removeprefix("residuals_")
        rms = next((f" Rms {row[2]}, largest {row[4]}." for row in rows if row[0] == name), "")
        section.items.append(
            Picture(
                picture.read_bytes(),
                f"Residuals of {name}: every point, and their mean over cells of the image.",
                f"Arrows of the residuals over the image of {name}.{rms}",
            )
        )
    return section
