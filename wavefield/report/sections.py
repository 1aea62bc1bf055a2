"""The parts of the report: which figures, with which words."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
import yaml

from wavefield import figures
from wavefield.measurement import Plan, Settings
from wavefield.measurement.diagnostics import diagnose_around
from wavefield.report.page import Listing, Markup, Picture, Section, Table, Text
from wavefield.report.pair_pictures import pair_differences, pair_misfits
from wavefield.report.player import MARKUP
from wavefield.report.sources import Sources
from wavefield.rig.pairs import pairs_of
from wavefield.rig.resolution import pixel_size
from wavefield.variables import FrameStatus, Quality


def _rms(values: xr.DataArray | np.ndarray) -> float:
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def _number(value: float, unit: str = "", digits: int = 3) -> str:
    if not np.isfinite(value):
        return "–"
    return f"{value:.{digits}g}{' ' + unit if unit else ''}"


def summary(sources: Sources) -> Section:
    """Build the first screen: what was measured, how much of it, how well.

    Parameters
    ----------
    sources : Sources
        What there is.

    Returns
    -------
    Section
    """
    cube = sources.cube
    part = sources.thinned("z", "u", "v", "w", "eps_y", "eps_piv", "quality")
    seen = (part.quality != 0) & ((part.quality & int(Quality.OUTSIDE)) == 0)
    measured = ((part.quality & int(Quality.MEASURED)) != 0).sum() / max(int(seen.sum()), 1)
    status = cube.frame_status.values
    rate = float(cube.attrs["frame_rate"])
    grid = sources.grid
    ny, nx = cube.sizes["y"], cube.sizes["x"]
    rows = [
        ("steps", f"{cube.sizes['time']} at {rate:g} Hz, {cube.sizes['time'] / rate:.4g} s"),
        (
            "ledger",
            ", ".join(
                f"{int((status == s).sum())} {s.name.lower().replace('_', ' ')}"
                for s in FrameStatus
                if (status == s).any()
            ),
        ),
        ("grid", f"{nx} x {ny} nodes, {grid.step * 100:g} cm apart"),
        ("measured nodes in view", f"{100 * float(measured):.2f} %"),
        ("rms of z about its mean", _number(100 * float(part.z.std()), "cm")),
        ("rms of u, v, w", ", ".join(_number(100 * _rms(part[n])) for n in "uvw") + " cm s⁻¹"),
        ("rms of eps_y", _number(1e3 * _rms(part.eps_y), "mm") + " (paper: 0.4–0.8 mm)"),
        ("rms of eps'", _number(_rms(part.eps_piv), "px") + " (paper: 0.34–0.37 px)"),
    ]
    statistics = sources.group("statistics")
    if statistics is not None:
        for name, label, factor, unit in (
            ("significant_height", "significant height Hs", 100, "cm"),
            ("peak_frequency", "frequency of the spectral peak", 1, "Hz"),
            ("steepness", "steepness k_p σ", 1, ""),
            ("slope_rms", "rms slope", 1, ""),
        ):
            if name in statistics:
                rows.append((label, _number(factor * float(statistics[name]), unit)))
    items: list[Any] = [Table("The run in numbers", ("quantity", "value"), rows)]
    if sources.notes:
        items.append(Text("Not in this report: " + "; ".join(sources.notes) + "."))
    return Section("Summary", items)


def setup(sources: Sources) -> Section:
    """Build the part on cameras and frames.

    Parameters
    ----------
    sources : Sources
        What there is.

    Returns
    -------
    Section
    """
    section = Section("Set-up")
    if sources.rig is None:
        return section
    rig, grid = sources.rig, sources.grid
    pairs, velocity = _roles(sources)
    section.items.append(
        Picture(
            figures.method_diagram(pairs, velocity),
            "How a step is made: parallax between cameras gives the surface at each frame time; the "
            "displacement "
            "from one frame to the next in each camera, read on the surface at mid-time, gives the velocity.",
            "Diagram. Frames of "
            + ", ".join(velocity)
            + " at t and t + dt. Stereo pairs "
            + ", ".join(f"{a} with {b}" for a, b in pairs)
            + " give the surface; displacements in time give u, v, w on it.",
        )
    )
    places = ", ".join(
        f"{name} at ({c[0]:.2f}, {c[1]:.2f}, {c[2]:.2f}) m"
        for name, c in ((name, camera.centre) for name, camera in rig.cameras.items())
    )
    section.items.append(
        Picture(
            figures.rig_views(rig, grid),
            "The rig from the side and from above, and a point 5 cm above the water at rest with its "
            "apparent "
            "positions on the plane z = 0, from which its height follows.",
            f"Drawing of the rig to scale. {places}.",
        )
    )
    frames = _middle_frames(sources)
    if frames:
        section.items.append(
            Picture(
                figures.camera_frames(frames, rig, grid),
                "One frame of each camera with the outline of the grid on the water at rest (yellow), and "
                "the middle 10 cm "
                "of it enlarged (blue square), to judge the seeding.",
                "Images of "
                + ", ".join(f"{n}, {f.shape[1]} x {f.shape[0]} px" for n, f in frames.items())
                + ".",
            )
        )
    return section


def _roles(sources: Sources) -> tuple[list[tuple[str, str]], list[str]]:
    """Pairs for the surface and cameras for the velocity, as the run chose them."""
    assert sources.rig is not None
    settings = sources.recipe.get("settings", {})
    names = list(sources.rig)
    pairs = [(str(a), str(b)) for a, b in settings.get("pairs", ())] or list(pairs_of(sources.rig, names))
    return pairs, list(settings.get("velocity_cameras", ())) or names


def _middle_frames(sources: Sources) -> dict[str, np.ndarray]:
    if not sources.frames or sources.rig is None:
        return {}
    series = sources.frames
    out = {}
    for name in sources.rig:
        if name in series:
            for index in (len(series[name]) // 2, 0, len(series[name]) - 1):
                image = series[name].read(index).image
                if image is not None:
                    out[name] = image
                    break
    return out


def surface(sources: Sources) -> Section:
    """Build the part on the surface and its velocity.

    Parameters
    ----------
    sources : Sources
        What there is.

    Returns
    -------
    Section
    """
    snap = sources.snapshot()
    z, w = 100 * snap.z, 100 * snap.w
    numbers = (
        f"At t = {float(snap.time):.3g} s z runs from {float(z.min()):.2g} to {float(z.max()):.2g} cm and "
        f"w from "
        f"{float(w.min()):.2g} to {float(w.max()):.2g} cm/s."
    )
    return Section(
        "Surface and velocity",
        [
            Markup(MARKUP),
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


def distributions(sources: Sources) -> Section:
    """Build the part on distributions.

    Parameters
    ----------
    sources : Sources
        What there is.

    Returns
    -------
    Section
    """
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
                        _number(100 * float(statistics["std"].sel(quantity=q))),
                        _number(float(statistics.skewness.sel(quantity=q))),
                        _number(float(statistics.kurtosis.sel(quantity=q))),
                    )
                    for q in statistics.quantity.values
                ],
            )
        )
    return Section("Distributions", items)


def spectra(sources: Sources) -> Section:
    """Build the part on spectra.

    Parameters
    ----------
    sources : Sources
        What there is.

    Returns
    -------
    Section
    """
    group, dispersion = sources.group("spectra"), sources.group("dispersion")
    section = Section("Spectra")
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
        errors = np.abs(dispersion.ridge_error.values)
        section.items.append(
            Picture(
                figures.dispersion_ridge(dispersion),
                "The ridge measured in the spectrum of w, and how far it is from linear theory.",
                f"The ridge over theory. Its median deviation by bands is "
                f"{100 * float(np.nanmedian(errors)):.2g} %.",
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


def nonlinearity(sources: Sources) -> Section:
    """Build the part on the kinematic condition.

    Parameters
    ----------
    sources : Sources
        What there is.

    Returns
    -------
    Section
    """
    snap = sources.snapshot()
    terms = figures.kinematic_terms(snap)
    rms = {name: 100 * _rms(terms[name]) for name in ("nonlinear", "residual")}
    section = Section(
        "Nonlinear term and coherence",
        [
            Picture(
                figures.kinematics_maps(snap),
                "Elevation, vertical velocity, the nonlinear term u·∇z, and what is left of z_t − w + "
                "u·∇z, at one "
                "moment; the last two share one colour scale.",
                f"Four maps. Rms of w {100 * _rms(snap.w):.3g} cm/s, of the nonlinear term "
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


def accuracy(sources: Sources) -> Section:
    """Build the part on errors: internal, against probes, against the truth where it is known.

    Parameters
    ----------
    sources : Sources
        What there is.

    Returns
    -------
    Section
    """
    part = sources.thinned("eps_y", "eps_piv")
    section = Section(
        "Accuracy",
        [
            Picture(
                figures.misfit_distributions(part),
                "Distributions of the stereo mismatch across the line of sight and of the misfit of the "
                "cameras' "
                "displacements: the measurement's own account of its errors.",
                f"Densities. Rms of eps_y {1e3 * _rms(part.eps_y):.3g} mm, of eps' "
                f"{_rms(part.eps_piv):.3g} px "
                "(paper: 0.4 to 0.8 mm, 0.34 to 0.37 px).",
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
        found = {n: _rms(errors[n]) / (pixel if n == "z" else rate * pixel) for n in "zuvw"}
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


def _pairs(sources: Sources) -> list[Picture | Table]:
    """Every pair of cameras on its own, if the images are still there."""
    if not sources.frames or sources.rig is None:
        return []
    settings = Settings.from_dict(sources.recipe.get("settings", {}))
    plan = Plan(sources.rig, sources.grid, settings)
    pixel = pixel_size(sources.rig, sources.grid)
    series = sources.frames
    steps = min(len(series[name]) for name in plan.cameras) - 1
    middle = sources.cube.sizes["time"] // 2
    found = diagnose_around(lambda name, frame: series[name].read(frame).image, steps, plan, middle, pixel)
    if found is None:
        return []
    steps = len(next(iter(found.z.values())))
    rows = found.table()
    words = ", ".join(f"{row['name']} {row['px']:.2g} px" for row in rows)
    out: list[Picture | Table] = [
        Picture(
            pair_misfits(found),
            f"The same for each pair of cameras on its own, over {steps} steps measured again, with the "
            "matches that the run rejects for their eps_y.",
            f"Densities of eps_y and of eps' for each pair. Rms: {words}.",
        )
    ]
    if found.difference:
        out.append(
            Picture(
                pair_differences(found),
                "Differences between what the pairs measure, each on its own (divided by √2 they are errors "
                "of one pair; paper: 0.3 px), and of z recombined from two pairs from z of the direct one.",
                "Densities of differences of z, dx, dy, dz; their rms is in the table.",
            )
        )
    table = [
        (
            row["name"],
            "" if row["cm"] is None else f"{row['cm']:.2g}",
            f"{row['px']:.2g}",
            "" if row["share"] is None else f"{100 * row['share']:.1f} %",
        )
        for row in rows
    ]
    caption = (
        f"Cameras against one another: rms of what is within three times the rms, and the share that is "
        f"beyond; 1 px is {1e3 * pixel:.2g} mm"
    )
    return [*out, Table(caption, ("error", "cm", "px", "beyond"), table)]


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


def coverage(sources: Sources) -> Section:
    """Build the part on coverage and faults.

    Parameters
    ----------
    sources : Sources
        What there is.

    Returns
    -------
    Section
    """
    cube = sources.cube
    status = cube.frame_status.values
    faulty = np.flatnonzero(status != int(FrameStatus.DONE))
    section = Section(
        "Coverage and faults",
        [
            Picture(
                figures.coverage_map(cube),
                "Share of time in which each node was measured, and in which it was filled from its "
                "neighbours.",
                "Two maps in percent.",
            ),
            Picture(
                figures.fault_history(cube),
                "Course of the measured, filled and rejected shares of the nodes in view, and the ledger "
                "of the run.",
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


def calibration(sources: Sources) -> Section:
    """Build the part on the calibration, from the report that `wavefield calibrate` left beside the rig.

    Parameters
    ----------
    sources : Sources
        What there is.

    Returns
    -------
    Section
    """
    section = Section("Calibration")
    folder = sources.calibration_folder
    if folder is None:
        return section
    numbers = yaml.safe_load((folder / "numbers.yaml").read_text(encoding="utf-8")) or {}
    rows = [
        (
            name,
            str(len(c["views"])),
            _number(c["rms_px"], "px"),
            _number(c["rms_mm"], "mm"),
            _number(c["max_px"], "px"),
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


def recipe(sources: Sources) -> Section:
    """Build the part on how the cube was made.

    Parameters
    ----------
    sources : Sources
        What there is.

    Returns
    -------
    Section
    """
    attrs = {k: v for k, v in sources.cube.attrs.items() if k != "recipe"}
    rows = [(name, str(value)) for name, value in attrs.items() if len(str(value)) < 300]
    section = Section("Recipe", [Table("Attributes of the store", ("attribute", "value"), rows)])
    if sources.recipe:
        section.items.append(
            Listing("The recipe: settings, rig, experiment, versions", json.dumps(sources.recipe, indent=1))
        )
    return section


SECTIONS: tuple[Callable[[Sources], Section], ...] = (
    summary,
    setup,
    surface,
    distributions,
    spectra,
    nonlinearity,
    accuracy,
    coverage,
    calibration,
    recipe,
)
