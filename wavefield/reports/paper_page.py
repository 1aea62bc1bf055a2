"""Every figure and number of the paper on one page, from one cube, its waves and a record at rest."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

from wavefield import figures
from wavefield.atomic_write import PAGE, check_writable, write_text
from wavefield.errors import StoreError, WavefieldError
from wavefield.measurement import GridGeometry, Settings
from wavefield.measurement.diagnostics import Diagnosis, diagnose, joined, pooled
from wavefield.reports.html_page import Head, Picture, ReportSection, Table, Text, render
from wavefield.reports.number_text import number, rms_of
from wavefield.reports.pair_pictures import pair_differences, pair_misfits
from wavefield.reports.sources import Sources, gather
from wavefield.rig.resolution import pixel_size
from wavefield.store.store_paths import beside
from wavefield.waves import analyze, kinematics, plane_coherence

_PAIR_STEPS = 8  # spread over the record: each is matched again, pair by pair
_SOURCES = {"stereo": "stereo z", "w": "integrated w", "cross": "cross-spectrum", "fusion": "fusion"}


def paper(
    store: str | Path,
    output: str | Path | None = None,
    *,
    rest: str | Path | None = None,
    waves: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write the figures and numbers of the paper for one experiment as one HTML file that opens offline.

    Parameters
    ----------
    store : path
        The cube.
    output : path, optional
        File to write; by default ``..._paper.html`` beside the cube.
    rest : path, optional
        Cube of the water at rest, by the same cameras; without it there is no figure at rest.
    waves : path, optional
        Waves of the cube; by default those that lie beside it, which are made first if there are none.
    progress : callable, optional
        Told (parts done, all parts).

    Returns
    -------
    Path
        The file.

    Raises
    ------
    StoreError
        If a cube is not there, or the file cannot be written.
    CubeError
        If the record is too short for its waves.

    Examples
    --------
    >>> import wavefield as wf
    >>> page = wf.paper("cube.zarr", "paper.html", rest="rest.zarr")  # doctest: +SKIP
    >>> page.name  # doctest: +SKIP
    'paper.html'
    """
    store = Path(store)
    output = Path(output) if output is not None else beside(store, "paper", ".html")
    check_writable(output, PAGE)
    waves = Path(waves) if waves is not None else beside(store, "waves", ".zarr")
    if not waves.is_dir():
        analyze(store, waves)
    sources = gather(store, waves)
    still = None if rest is None else gather(rest).cube
    builders = (_snapshot, _distributions, _spectrum, _nonlinear, _probes)
    total = len(builders) + 3
    sections = []
    for i, build in enumerate(builders):
        if progress:
            progress(i, total)
        sections.append(build(sources))
    sections.append(_rest(sources, still))
    if progress:
        progress(total - 2, total)
    found = _pairs(sources)
    sections.append(_consistency(sources, found))
    sections.append(_numbers(sources, still, found))
    name = str(sources.cube.attrs.get("experiment", "")) or "unnamed experiment"
    subtitle = f"The figures of Aubourg et al. for {sources.cube.sizes['time']} steps"
    parts = [(section, section.html()) for section in sections if section.items]
    write_text(output, render(Head(f"{name}: the paper's figures", (subtitle,)), parts, {}), PAGE)
    if progress:
        progress(total, total)
    return output


def _group(sources: Sources, name: str) -> xr.Dataset:
    found = sources.group(name)
    if found is None:
        raise StoreError(f"the wave store has no group {name!r}: run `wavefield analyze` again")
    return found


def _pixel(sources: Sources) -> float:
    return pixel_size(sources.rig, sources.grid) if sources.rig is not None else float("nan")


def _snapshot(sources: Sources) -> ReportSection:
    snap = sources.snapshot()
    alt = f"Elevation from {100 * float(snap.z.min()):.2g} to {100 * float(snap.z.max()):.2g} cm"
    return ReportSection(
        "Surface and velocity",
        [
            Picture(figures.surface_3d(snap), "The surface at one moment, heights exaggerated.", alt + "."),
            Picture(
                figures.velocity_map(snap),
                "Its velocity: w in colour, u and v as arrows.",
                f"Map of the velocity. Rms of w {100 * rms_of(snap.w):.3g} cm/s.",
            ),
        ],
    )


def _distributions(sources: Sources) -> ReportSection:
    part = sources.thinned("z", "u", "v", "w")
    rows = []
    rate = float(sources.cube.attrs["frame_rate"])
    for name, scale in (("z", 100.0), ("u", 100 / rate), ("v", 100 / rate), ("w", 100 / rate)):
        values = scale * part[name]
        label = name if name == "z" else f"d{dict(zip('uvw', 'xyz'))[name]}"
        rows.append((label, number(float(values.std())), number(float(np.abs(values).max()))))
    return ReportSection(
        "Distributions",
        [
            Picture(
                figures.distributions(part),
                "Distributions of z and of the displacements in one step, with Gaussians.",
                "Densities of z, dx, dy and dz on a logarithmic axis.",
            ),
            Table("Standard deviation and largest magnitude, cm", ("", "σ", "largest"), rows),
        ],
    )


def _spectrum(sources: Sources) -> ReportSection:
    group, dispersion = _group(sources, "spectra"), sources.group("dispersion")
    energy = group.E_komega_w.values
    decades = float(np.log10(energy.max() / np.median(energy[energy > 0])))
    return ReportSection(
        "Spectrum of the vertical velocity",
        [
            Picture(
                figures.komega_map(group, dispersion),
                "E(k, ω) of w; dispersion relation of gravity-capillary waves and, dashed, ω = √(gk).",
                f"Map of E(k, omega); its peak is {decades:.1f} decades above the median.",
            ),
            Picture(
                figures.wavevector_map(group, dispersion),
                "E(kx, ky) at chosen frequencies; the dashed circle is the dispersion relation.",
                "Maps of the spectrum over the direction of travel.",
            ),
        ],
    )


def _nonlinear(sources: Sources) -> ReportSection:
    snap = sources.snapshot()
    at = int(np.argmin(np.abs(sources.cube.time.values - float(snap.time))))
    first = min(max(at - 1, 0), max(sources.cube.sizes["time"] - 3, 0))
    around = sources.cube[["z", "z_t", "u", "v", "w"]].isel(time=slice(first, first + 3)).load()
    terms = kinematics(around.assign_attrs(sources.cube.attrs)).isel(time=at - first)
    plane = plane_coherence(sources.cube)
    coherence = _group(sources, "coherence")
    last = f"mean {float(plane.mean_C_tot[: plane.sizes['k'] // 4].mean()):.3f} over the lowest quarter"
    return ReportSection(
        "Nonlinear term",
        [
            Picture(
                figures.kinematics_maps(snap, sources.cube),
                "η, w, u·∇η and the error ∂η/∂t − w + u·∇η at one moment.",
                f"Four maps. Rms of u·∇η {100 * rms_of(terms.nonlinear):.3g} cm/s, of the error"
                f" {100 * rms_of(terms.residual):.3g} cm/s.",
            ),
            Picture(
                figures.vorticity_map(terms),
                "Vertical vorticity and divergence of the surface water at the same moment.",
                f"Two maps. Rms of the vorticity {rms_of(terms.vorticity):.3g} 1/s, of the divergence"
                f" {rms_of(terms.divergence):.3g} 1/s.",
            ),
            Picture(
                figures.plane_coherence_maps(plane),
                "Coherence at each wave vector, averaged over time; and the three curves averaged over angle"
                " after the ratio, as the paper has them.",
                f"Map of the coherence over kx, ky, and curves over k; with the sum {last} of k.",
            ),
            Picture(
                figures.coherence_curves(coherence),
                "The same curves averaged over angle before the ratio, which leaves no bias, and the standard"
                " coherence.",
                "Curves of coherence over k with the level of chance.",
            ),
        ],
    )


def _probes(sources: Sources) -> ReportSection:
    group, fusion = _group(sources, "spectra"), _group(sources, "fusion")
    rows = [
        (
            _SOURCES.get(str(name), str(name)),
            number(float(fusion.range_decades.sel(source=name)), digits=2),
            number(float(fusion.range_frequency.sel(source=name)), "Hz", 2),
        )
        for name in fusion.source.values
    ]
    without = "" if "Ez_probes" in group else " The experiment has no wave probes."
    return ReportSection(
        "Spectrum of the elevation",
        [
            Picture(
                figures.elevation_spectra(group),
                "Spectrum of the elevation by each method, and of the wave probes." + without,
                "Curves on logarithmic axes.",
            ),
            Table("Right within a factor 2", ("method", "decades below the peak", "up to"), rows),
        ],
    )


def _rest(sources: Sources, still: xr.Dataset | None) -> ReportSection:
    section = ReportSection("Water at rest")
    if still is None:
        section.items.append(Text("No record at rest was given (--rest): the paper's figure needs one."))
        return section
    fields = still[["z", "u", "v", "w"]].load().assign_attrs(still.attrs)
    rate, pixel = float(still.attrs["frame_rate"]), _pixel(sources)
    centred = fields.z - fields.z.mean("time")
    sizes = {
        "z − z_rest": rms_of(fields.z),
        "z − ⟨z⟩ − z_rest": rms_of(centred),
        **{f"d{a}": rms_of(fields[n]) / rate for a, n in zip("xyz", "uvw")},
    }
    rows = [(name, number(100 * v, "cm", 2), number(v / pixel, "px", 2)) for name, v in sizes.items()]
    section.items += [
        Picture(
            figures.rest_distributions(fields),
            "z − z_rest, with and without each node's mean over time, and the displacements, which should be"
            " zero.",
            f"Densities. Rms of z {1e3 * sizes['z − z_rest']:.2g} mm, about the mean"
            f" {1e3 * sizes['z − ⟨z⟩ − z_rest']:.2g} mm.",
        ),
        Table(f"Rms over {still.sizes['time']} steps at rest", ("", "", ""), rows),
    ]
    return section


def _pairs(sources: Sources) -> Diagnosis | None:
    # every pair of cameras on its own, at steps spread over the whole record
    if not sources.frames or sources.rig is None:
        return None
    settings = Settings.from_dict(sources.recipe.get("settings", {}))
    geometry = GridGeometry(sources.rig, sources.grid, settings)
    series, pixel = sources.frames, _pixel(sources)
    steps = min(len(series[name]) for name in geometry.cameras) - 1
    found = []
    for step in np.unique(np.linspace(0, steps - 1, _PAIR_STEPS).round().astype(int)):
        try:
            frames = {n: [series[n].read(int(step) + k).image for k in (0, 1)] for n in geometry.cameras}
            found.append(diagnose(frames, geometry, pixel=pixel))
        except (ValueError, WavefieldError):  # a frame is missing or bad
            continue
    return pooled(found) if found else None


def _consistency(sources: Sources, found: Diagnosis | None) -> ReportSection:
    section = ReportSection("Pairs of cameras against one another")
    if found is None:
        section.items.append(
            Text("The images are not there any more: pairs cannot be measured on their own.")
        )
        return section
    count = len(next(iter(found.z.values())))
    section.items.append(
        Picture(
            pair_misfits(found),
            f"eps_Y of each pair of cameras and eps' of each camera pair, at {count} steps spread over the"
            " record.",
            "Densities of the errors of each pair.",
        )
    )
    if found.difference:
        section.items.append(
            Picture(
                pair_differences(found),
                "Differences of z between pairs, over √2.",
                "Densities of the differences.",
            )
        )
    return section


def _numbers(sources: Sources, still: xr.Dataset | None, found: Diagnosis | None) -> ReportSection:
    pixel = _pixel(sources)
    rows: list[tuple[str, str, str]] = []
    if still is not None:
        z = still.z.load()
        rows.append(("z at rest, rms", "0.07 cm", number(100 * rms_of(z), "cm", 2)))
        rows.append(
            ("the same, means taken off", "0.05 cm", number(100 * rms_of(z - z.mean("time")), "cm", 2))
        )
    if found is not None:
        for pair, values in found.eps_y.items():
            rows.append(
                (f"eps_Y, pair {joined(pair)}", "0.04 to 0.08 cm", number(100 * rms_of(values), "cm", 2))
            )
            z_std = number(100 * found.z_std[pair], "cm", 2)
            rows.append((f"σ_z from it, pair {joined(pair)}", "0.048 to 0.058 cm", z_std))
        for pairs, values in found.difference.items():
            names = " − ".join(joined(p) for p in pairs)
            rows.append((f"z {names}, over √2", "0.057 cm", number(100 * rms_of(values) / 2**0.5, "cm", 2)))
        for cameras, values in found.eps_piv.items():
            rows.append(
                (f"eps', cameras {joined(cameras)}", "0.34 to 0.37 px", number(rms_of(values), "px", 2))
            )
    fusion, dispersion = _group(sources, "fusion"), sources.group("dispersion")
    rows.append(("noise of z without a rest record", "–", number(100 * float(fusion.sigma_z), "cm", 2)))
    rows.append(("noise of dz without a rest record", "–", number(100 * float(fusion.sigma_dz), "cm", 2)))
    if dispersion is not None and "ridge_error" in dispersion:
        worst = 100 * float(np.abs(dispersion.ridge_error).max())
        rows.append(("ridge against linear theory, largest", "to 5 Hz by eye", number(worst, "% of k", 2)))
    kinetic = sources.group("kinematics")
    if kinetic is not None:
        rows.append(
            ("u·∇η over w, rms", "about 10 %", number(100 * float(kinetic.nonlinear_fraction), "%", 2))
        )
    caption = "Numbers of the paper and of this experiment" + (
        f"; 1 px is {1e3 * pixel:.2g} mm" if np.isfinite(pixel) else ""
    )
    return ReportSection("Numbers", [Table(caption, ("", "paper", "here"), rows)])
