"""Sections of a report on set-up, elevation, distributions and coverage, and the data of its animation."""

import base64
import json
import zlib

import numpy as np
import xarray as xr
from matplotlib import colormaps

from wavefield import figures
from wavefield.errors import WavefieldError
from wavefield.figures.display import SIGNED, limit, thin
from wavefield.pipeline import Run
from wavefield.reports.html import Item, Picture, ReportSection, Table
from wavefield.reports.numbers import extremes_of, number, snapshot, thinned
from wavefield.variables import FrameStatus

MAX_STEPS = 1500  # steps in the middle of the record that are compared with probes
MAX_PROBES = 3  # probes that are drawn; the table lists all


def surface_picture(snap: xr.Dataset) -> Picture:
    """Return a 3D picture of the surface at one step (y, x) of a cube."""
    return Picture(
        figures.surface_3d(snap),
        "The surface at one moment; heights are exaggerated, colour is the vertical velocity.",
        f"Three-dimensional view of the surface. {extremes_of(snap)}",
    )


def snapshots(run: Run) -> ReportSection:
    """Return the section with pictures of the surface and its velocity at one step near mid-record."""
    snap = snapshot(run.cube)
    velocity = Picture(
        figures.velocity_map(snap),
        "Velocity of the surface water at the same moment: w in colour, u and v as arrows.",
        f"Map of the vertical velocity with arrows of the horizontal velocity. {extremes_of(snap)}",
    )
    return ReportSection("Surface and velocity", [surface_picture(snap), velocity], layout="beside")


def distributions(run: Run) -> ReportSection:
    """Return the section on the probability densities of z and the displacements, and on their moments."""
    part, rate = thinned(run.cube, "z", "u", "v", "w"), float(run.cube.attrs["frame_rate"])
    stds = [f"z {100 * float(part.z.std()):.3g} cm"]
    stds += [f"d{axis} {100 / rate * float(part[n].std()):.3g} cm" for axis, n in zip("xyz", "uvw")]
    picture = Picture(
        figures.distributions(part),
        "Probability densities of the elevation and of the displacements in one step, with Gaussians of the "
        "same standard deviation.",
        f"Densities on a logarithmic scale. Standard deviations: {', '.join(stds)}.",
    )
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
    """Return the section on where and when the surface was measured, and on steps with faults."""
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
    return section


def setup(run: Run) -> ReportSection:
    """Return the section on the cameras: drawings of the rig and an image of each camera."""
    section = ReportSection("Set-up", folded=True)
    if run.rig is None:
        return section
    section.gist = f"{len(run.rig)} cameras: {', '.join(run.rig)}"
    rig, grid = run.rig, run.grid
    positions = ", ".join(
        f"{name} at ({x:.2f}, {y:.2f}, {z:.2f}) m"
        for name, (x, y, z) in ((name, camera.centre) for name, camera in rig.cameras.items())
    )
    section.items += [
        Picture(
            figures.rig_views(rig, grid),
            "The rig from the side and from above.",
            f"Drawing of the rig to scale. {positions}.",
        ),
    ]
    frames = _middle_frames(run)
    if frames:
        sizes = ", ".join(f"{name}, {image.shape[1]} x {image.shape[0]} px" for name, image in frames.items())
        section.items.append(
            Picture(
                figures.camera_frames(frames, rig, grid),
                "One frame of each camera with the outline of the grid on the still water (yellow), and the "
                "middle 10 cm of it enlarged (blue square), to judge the seeding.",
                f"Images of {sizes}.",
            )
        )
    return section


def _middle_frames(run: Run) -> dict[str, np.ndarray]:
    """Return, by camera of the rig, its middle frame (row, column), or the first or last that can be read.
    Cameras are left out if none of these three can be read."""
    out = {}
    for name, series in run.frames.items():
        if run.rig is not None and name in run.rig.cameras:
            images = (series.read(k).image for k in (len(series) // 2, 0, len(series) - 1))
            image = next((image for image in images if image is not None), None)
            if image is not None:
                out[name] = image
    return out


def elevation(run: Run) -> ReportSection:
    """Return the section on the spectrum of the elevation and on the wave probes."""
    items = [*elevation_pictures(run), *probe_items(run)]
    title = "Elevation and wave probes" if probes_of(run)[0] is not None else "Elevation"
    return ReportSection(title, items, layout="beside")


def probes_of(run: Run) -> tuple[xr.Dataset | None, str]:
    """Return the wave probes of a run and "". Without probes, return None and the reason why they are absent.
    The reason is empty if the experiment names no probes."""
    try:
        probes = run.probes
    except WavefieldError as error:
        return None, str(error)
    named = run.experiment is not None and run.experiment.probes is not None
    return probes, run.reason("probes") if named else ""


def elevation_pictures(run: Run) -> list[Item]:
    """Return a picture of the elevation spectra by all methods; [] if the waves are not analysed."""
    group, fusion = run.wave_group("spectra"), run.wave_group("fusion")
    if group is None or "Ez" not in group:
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


def probe_items(run: Run) -> list[Item]:
    """Return a picture of the elevation over time, by probes and cameras, and a table of differences.
    The list is empty if the run has no probes; it has only the table if no probe can be compared."""
    probes, _ = probes_of(run)
    if probes is None:
        return []
    found = {
        str(name): at_probe(run.cube, probes.isel(probe=k)) for k, name in enumerate(probes.probe.values)
    }
    rows, compared = [], []
    for name, one in found.items():
        if isinstance(one, str):
            rows.append((name, one, "–"))
            continue
        compared.append(one)
        difference = number(1e3 * float(one.rms_difference), "mm", 2)
        rows.append((name, difference, f"{min(float(one.correlation), 0.9999):.4f}"))
    caption = "Wave probes and the elevation measured at their positions, each minus its mean"
    table = Table(caption, ("probe", "rms difference, or why there is none", "correlation"), rows)
    if not compared:
        return [table]
    drawn = xr.concat(compared[:MAX_PROBES], "probe")
    which = f"the first {MAX_PROBES} of them" if len(compared) > MAX_PROBES else "the probes in the grid"
    picture = Picture(
        figures.probe_series(drawn),
        f"Elevation by {which} and by the cameras at the same positions; the rms of the difference is over "
        f"{drawn.sizes['time']} steps.",
        f"Curves over time. {'; '.join(f'{name}: rms difference {words}' for name, words, _ in rows)}.",
    )
    return [picture, table]


def at_probe(cube: xr.Dataset, probe: xr.Dataset) -> xr.Dataset | str:
    """Compare a probe with z of a cube at its position, in up to 1500 steps in the middle of the record.
    Return z of the cube and elevation by the probe (time,), each minus its mean, m, with rms_difference, m,
    and correlation. If they cannot be compared, return the reason as a string."""
    first = max(0, (cube.sizes["time"] - MAX_STEPS) // 2)
    z = cube.z.isel(time=slice(first, first + MAX_STEPS))
    time, x, y = z["time"].values.astype(float), float(probe.probe_x), float(probe.probe_y)
    if not np.isfinite([x, y]).all():
        return "the experiment file does not give its position"
    if not (z.x.min() <= x <= z.x.max() and z.y.min() <= y <= z.y.max()):
        return f"outside the grid, at x {x:.3g} m, y {y:.3g} m"
    j, i = (int(np.clip(np.searchsorted(z[d], at) - 1, 0, z.sizes[d] - 2)) for d, at in (("y", y), ("x", x)))
    around = z.isel(x=slice(i, i + 2), y=slice(j, j + 2)).load()
    here = around.interp(x=x, y=y).values.astype(float)
    clock, values = probe["time"].values.astype(float), probe["elevation"].values.astype(float)
    good = np.isfinite(values)
    there = np.full_like(here, np.nan)
    if good.sum() > 1:
        there = np.interp(time, clock[good], values[good], left=np.nan, right=np.nan)
    both = np.isfinite(here) & np.isfinite(there)
    if both.sum() < 2:
        return "no values while the cameras recorded"
    here, there = here - here[both].mean(), there - there[both].mean()
    spread = float(here[both].std() * there[both].std())
    return xr.Dataset(
        {
            "z": ("time", here),
            "elevation": ("time", there),
            "rms_difference": float(np.sqrt(np.mean((here - there)[both] ** 2))),
            "correlation": float(np.mean((here * there)[both])) / spread if spread else np.nan,
        },
        {"time": time, "probe": str(probe.probe.item())},
    )


MAX_NODES = 8_000  # nodes of a field in the player; a screen shows no more
MAX_BYTES = 1_500_000  # of the uncompressed fields; compression halves them at least


def excerpt(cube: xr.Dataset) -> xr.Dataset:
    """Return the part of z, u, v, w (time, y, x) that the animation shows, loaded.
    To limit the size of the page, it has only steps in the middle of the record and every n-th node."""
    every = max(1, int(np.ceil(np.sqrt(cube.sizes["x"] * cube.sizes["y"] / MAX_NODES))))
    part = cube[["z", "u", "v", "w"]].isel(x=slice(None, None, every), y=slice(None, None, every))
    steps = max(2, MAX_BYTES // (2 * part.sizes["x"] * part.sizes["y"]))
    first = max(0, (cube.sizes["time"] - steps) // 2)
    return part.isel(time=slice(first, first + steps)).transpose("time", "y", "x").load()


def _code(values: np.ndarray, half: float) -> str:
    """Return values (time, y, x) from -`half` to `half` as codes 1 to 255, missing ones as 0, in base 64.
    Before the encoding, differences of the codes along x and y, modulo 256, are compressed."""
    scaled = np.round(np.clip(128 + 127 * values / half, 1, 255))
    codes = np.where(np.isfinite(values), scaled, 0).astype(np.uint8)
    differences = np.diff(np.diff(codes, axis=2, prepend=np.uint8(0)), axis=1, prepend=np.uint8(0))
    return base64.b64encode(zlib.compress(differences.tobytes(), 9)).decode()


def pack(cube: xr.Dataset) -> dict[str, str]:
    """Return the data of the animation of a cube (time, y, x): texts for the page's script, by HTML id.
    "field-description" is JSON; "field-z", "field-w", "field-u" and "field-v" are encoded by `_code`."""
    part = excerpt(cube)
    some = thin(part.sizes["x"], part.sizes["y"])
    arrows = 100 * part[["u", "v"]].isel(x=some, y=some).astype(float)
    fastest = limit(np.hypot(arrows.u.values, arrows.v.values), 98)
    fields = {name: 100 * part[name].values.astype(float) for name in "zw"}
    ends = {name: limit(values) for name, values in fields.items()}
    description = {
        "nx": part.sizes["x"],
        "ny": part.sizes["y"],
        "x": [float(part.x[0]), float(part.x[-1])],
        "y": [float(part.y[0]), float(part.y[-1])],
        "time": [round(float(t), 6) for t in part.time.values],
        "ends": ends,  # ends of the colour scales of z (cm) and w (cm/s)
        "arrows": {
            "x": arrows.x.values.tolist(),
            "y": arrows.y.values.tolist(),
            "fastest": fastest,
            "length": 1.4 * some.step * float(np.mean(np.diff(part.x.values))),
        },
        "colours": np.rint(255 * colormaps[SIGNED](np.linspace(0, 1, 256))[:, :3]).astype(int).tolist(),
    }
    out = {"field-description": json.dumps(description)}
    out |= {f"field-{name}": _code(values, ends[name]) for name, values in fields.items()}
    return out | {f"field-{name}": _code(arrows[name].values, 1.3 * fastest) for name in "uv"}
