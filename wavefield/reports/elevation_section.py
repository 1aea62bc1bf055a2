"""Section on the elevation: its spectrum by each method, beside wave probes over time."""

import numpy as np
import xarray as xr

from wavefield import figures
from wavefield.errors import WavefieldError
from wavefield.pipeline import Run
from wavefield.reports.html_page import Item, Picture, ReportSection, Text
from wavefield.reports.number_text import number

MAX_STEPS = 1500  # that are compared with probes, in the middle of the record
MAX_PROBES = 3  # drawn, of those that lie in the grid


def elevation(run: Run) -> ReportSection:
    """Spectrum of the elevation and probes over time."""
    items = [*elevation_pictures(run), *probe_items(run)]
    title = "Elevation and wave probes" if probes_of(run)[0] is not None else "Elevation"
    return ReportSection(title, items, layout="beside")


def probes_of(run: Run) -> tuple[xr.Dataset | None, str]:
    """The probes of a run, or None and the reason; no reason where the experiment names none."""
    try:
        probes = run.probes
    except WavefieldError as error:
        return None, str(error)
    named = run.experiment is not None and run.experiment.probes is not None
    return probes, run.reason("probes") if named else ""


def elevation_pictures(run: Run) -> list[Item]:
    """The spectrum of the elevation by each method."""
    group, fusion = run.wave_group("spectra"), run.wave_group("fusion")
    if group is None or "Ez_stereo" not in group:
        return []
    reach = ""
    if fusion is not None and "range_frequency" in fusion:
        reach = " They reach " + ", ".join(
            f"{source}: {float(fusion.range_frequency.sel(source=source)):.1f} Hz, "
            f"{float(fusion.range_decades.sel(source=source)):.1f} decades"
            for source in fusion.source.values
        )
    has_probes = "Ez_probes" in group
    return [
        Picture(
            figures.elevation_spectra(group),
            "Spectrum of the elevation by each method; thin where it is not reliable. The band is the 95 % "
            f"interval of the stereo spectrum.{'' if has_probes else ' Without wave probes.'}",
            f"Curves on logarithmic axes: {'probes, ' if has_probes else ''}stereo, integrated w, "
            f"cross-spectrum, fusion.{reach}",
        )
    ]


def noise_pictures(run: Run) -> list[Item]:
    """The noise of stereo z and of the integrated w."""
    group, fusion = run.wave_group("spectra"), run.wave_group("fusion")
    if group is None or "Ez_fusion" not in group or fusion is None or "noise_z" not in fusion:
        return []
    return [
        Picture(
            figures.noise_spectra(group, fusion),
            "Noise of the two measurements of the elevation, estimated without a still-water record, and "
            "the weight of each in their best combination.",
            f"Noise spectra and weights. Noise of z {1e3 * float(fusion.sigma_z):.3g} mm, of dz "
            f"{1e3 * float(fusion.sigma_dz):.3g} mm.",
        )
    ]


def probe_items(run: Run) -> list[Item]:
    """Probes over time beside the measured elevation at their places."""
    probes, _ = probes_of(run)
    if probes is None:
        return []
    compared = at_probes(run.cube, probes)
    if not compared.sizes["probe"]:
        nowhere = not np.isfinite(probes["probe_x"].values).any()
        reason = (
            "The experiment file does not state where the probes are (`places` in `probes:`)"
            if nowhere
            else "No probe lies in the grid while the cameras recorded"
        )
        return [Text(f"{reason}: only spectra are compared.")]
    shares = ", ".join(
        f"{one.probe.item()}: rms difference {number(1e3 * float(one.rms_difference), 'mm', 2)}, correlation "
        f"{min(float(one.correlation), 0.9999):.4f}"
        for one in (compared.isel(probe=k) for k in range(min(compared.sizes["probe"], MAX_PROBES)))
    )
    return [
        Picture(
            figures.probe_series(compared.isel(probe=slice(0, MAX_PROBES))),
            "Elevation by wave probes and by the cameras at the same places, each about its mean; rms of the "
            f"difference over {compared.sizes['time']} steps.",
            f"Curves over time. {shares}.",
        )
    ]


def at_probes(cube: xr.Dataset, probes: xr.Dataset) -> xr.Dataset:
    """Elevation of probes and of the cube there, (probe, time), about their means, m, in the record's middle.
    With the rms difference and the correlation of each; of probes in the grid with two steps at least.
    """
    first = max(0, (cube.sizes["time"] - MAX_STEPS) // 2)
    z, out = cube.z.isel(time=slice(first, first + MAX_STEPS)), []
    time = z["time"].values.astype(float)
    for k, name in enumerate(probes["probe"].values):
        x, y = float(probes["probe_x"][k]), float(probes["probe_y"][k])
        if not (z.x.min() <= x <= z.x.max() and z.y.min() <= y <= z.y.max()):
            continue
        here = _around(z, x, y).interp(x=x, y=y).values.astype(float)
        clock, values = probes["time"].values.astype(float), probes["elevation"].values[k].astype(float)
        good = np.isfinite(values)
        if good.sum() < 2:
            continue
        there = np.interp(time, clock[good], values[good], left=np.nan, right=np.nan)
        both = np.isfinite(here) & np.isfinite(there)
        if both.sum() < 2:
            continue
        here, there = here - here[both].mean(), there - there[both].mean()
        spread = float(here[both].std() * there[both].std())
        out.append(
            xr.Dataset(
                {
                    "z": ("time", here),
                    "elevation": ("time", there),
                    "rms_difference": float(np.sqrt(np.mean((here - there)[both] ** 2))),
                    "correlation": float(np.mean((here * there)[both])) / spread if spread else np.nan,
                },
                {"time": time, "probe": str(name)},
            )
        )
    return xr.concat(out, "probe") if out else xr.Dataset(coords={"probe": [], "time": time})


def _around(z: xr.DataArray, x: float, y: float) -> xr.DataArray:
    """z (time, y, x) at the nodes around a place, loaded."""
    i, j = (int(np.clip(np.searchsorted(z[d], at) - 1, 0, z.sizes[d] - 2)) for d, at in (("x", x), ("y", y)))
    return z.isel(x=slice(i, i + 2), y=slice(j, j + 2)).load()
