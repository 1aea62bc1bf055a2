"""Sections on the run: remarks, summary, set-up, recipe."""

import json
from collections.abc import Sequence

import numpy as np
import xarray as xr

from wavefield import figures
from wavefield.pipeline import Run
from wavefield.reports.html_page import Listing, Picture, ReportSection, Table, Text
from wavefield.reports.number_text import number, rms_of, without_folders
from wavefield.reports.run_data import thinned
from wavefield.rig.pairs import pairs_of
from wavefield.store.verdict import Verdict
from wavefield.variables import FrameStatus, Quality

_UNITS = {"frame_rate": "Hz", "measured_frame_rate": "Hz", "pixel_size": "m", "water_depth": "m"}
_LONG = 300  # letters: longer attributes are not in the table of metadata


def remarks(verdict: Verdict) -> ReportSection:
    """The remarks of a verdict."""
    rows = [
        (f"{r.subject}: {r.kind}", r.sentence, r.expected or "-", r.remedy or "-") for r in verdict.remarks
    ]
    head = ("remark", "measured", "expected", "what to do")
    return ReportSection("Remarks", [Table(f"The cube is {verdict.line}", head, rows)] if rows else [])


def summary(run: Run) -> ReportSection:
    """What was measured, how much of it, how well."""
    section = ReportSection("Summary", [Table("Run summary", ("quantity", "value"), _summary_rows(run))])
    absent = {
        "spectra and coherence": run.reason("waves"),
        "pictures of the cameras' frames": run.reason("frames"),
    }
    words = [f"{what} ({reason})" for what, reason in absent.items() if reason]
    if words:
        section.items.append(Text(f"Not in this report: {'; '.join(words)}."))
    return section


def _summary_rows(run: Run) -> list[tuple[str, str]]:
    cube = run.cube
    part = thinned(cube, "z", "u", "v", "w", "eps_y", "eps_piv", "quality")
    status, rate = cube.frame_status.values, float(cube.attrs["frame_rate"])
    in_view = (part.quality != 0) & ((part.quality & np.uint16(Quality.OUTSIDE | Quality.MASKED)) == 0)
    n_in_view = max(int(in_view.sum()), 1)
    measured = float(((part.quality & int(Quality.MEASURED)) != 0).sum()) / n_in_view
    counts = {s.name: int((status == s).sum()) for s in FrameStatus}
    rows = [
        ("steps", f"{cube.sizes['time']} at {rate:g} Hz, {cube.sizes['time'] / rate:.4g} s"),
        ("step status", ", ".join(f"{n} {s.lower().replace('_', ' ')}" for s, n in counts.items() if n)),
        ("grid", f"{cube.sizes['x']} x {cube.sizes['y']} nodes, {run.grid.step * 100:g} cm apart"),
    ]
    if "path_frames" in cube.coords:
        frames = int(cube.path_frames)
        stated = {1: "instantaneous", 2: "displacements over one step"}
        rows.append(("velocities", stated.get(frames, f"along paths of {frames} frames")))
    if "z_level_std" in cube:
        level = number(1e3 * float(cube.z_level_std), "mm")
        rows.append(("uncertainty of z = 0, common to all nodes", level))
    eps_y, eps_piv = number(1e3 * rms_of(part.eps_y), "mm"), number(rms_of(part.eps_piv), "px")
    rows += [
        ("measured nodes in view", f"{100 * measured:.2f} %"),
        *without_cameras(part.quality, n_in_view, cube.attrs.get("cameras", ())),
        ("rms of z about its mean", number(100 * float(part.z.std()), "cm")),
        ("rms of u, v, w", ", ".join(number(100 * rms_of(part[n])) for n in "uvw") + " cm/s"),
        ("mismatch of sight lines (eps_y), rms", f"{eps_y} (published for a similar rig: 0.4 to 0.8 mm)"),
        (
            "misfit of the displacements (eps'), rms",
            f"{eps_piv} (published for a similar rig: 0.34 to 0.37 px)",
        ),
    ]
    statistics = run.wave_group("statistics")
    for name, label, factor, unit in (
        ("significant_height", "significant height Hs", 100, "cm"),
        ("peak_frequency", "frequency of the spectral peak", 1, "Hz"),
        ("steepness", "steepness k_p σ", 1, ""),
        ("slope_rms", "rms slope", 1, ""),
    ):
        if statistics is not None and name in statistics:
            rows.append((label, number(factor * float(statistics[name]), unit)))
    return rows


def without_cameras(quality: xr.DataArray, n_in_view: int, cameras: Sequence[str]) -> list[tuple[str, str]]:
    """A row on the cameras without which nodes were measured, and how many; empty if there are none."""
    shares = []
    for index, camera in enumerate(cameras):
        bit = np.uint16(Quality.without(index) & ~Quality.FEWER_CAMERAS)
        share = float(((quality & bit) != 0).sum()) / n_in_view
        if share > 0:
            shares.append(f"{camera} {100 * share:.2f} %")
    return [("nodes measured without", ", ".join(shares))] if shares else []


def setup(run: Run) -> ReportSection:
    """Cameras and frames."""
    section = ReportSection("Set-up")
    if run.rig is None:
        return section
    rig, grid, settings = run.rig, run.grid, run.recipe.get("settings", {})
    pairs = [(str(a), str(b)) for a, b in settings.get("pairs", ())] or list(pairs_of(rig, list(rig)))
    velocity = list(settings.get("velocity_cameras", ())) or list(rig)
    stereo = ", ".join(f"{a} with {b}" for a, b in pairs)
    positions = ", ".join(
        f"{name} at ({x:.2f}, {y:.2f}, {z:.2f}) m"
        for name, (x, y, z) in ((name, camera.centre) for name, camera in rig.cameras.items())
    )
    section.items += [
        Picture(
            figures.method_diagram(pairs, velocity),
            "How a step is measured: parallax between cameras gives the surface at each frame time; the "
            "displacement from one frame to the next in each camera, evaluated on the surface at mid-time, "
            "gives the velocity.",
            f"Diagram. Frames of {', '.join(velocity)} at t and t + dt. Stereo pairs {stereo} give the "
            "surface; displacements in time give u, v, w on it.",
        ),
        Picture(
            figures.rig_views(rig, grid),
            "The rig from the side and from above, and a point 5 cm above the still water with its apparent "
            "positions on the plane z = 0, from which its height follows.",
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
    """A frame of every camera: the middle one, or the first or the last where that cannot be read."""
    out = {}
    for name, series in run.frames.items():
        if run.rig is not None and name in run.rig.cameras:
            images = (series.read(k).image for k in (len(series) // 2, 0, len(series) - 1))
            image = next((image for image in images if image is not None), None)
            if image is not None:
                out[name] = image
    return out


def recipe(run: Run) -> ReportSection:
    """How the cube was made."""
    folder = str(run.experiment.path.absolute().parent) if run.experiment else ""
    attrs = {k: v for k, v in run.cube.attrs.items() if k not in ("recipe", "fingerprints")}
    rows = [
        (str(name).replace("_", " "), _in_words(str(name), without_folders(value, folder)))
        for name, value in attrs.items()
        if len(str(value)) < _LONG
    ]
    section = ReportSection("Recipe", [Table("Metadata", ("", ""), rows)])
    if run.recipe:
        words = json.dumps(without_folders(run.recipe, folder), indent=1)
        section.items.append(Listing("The recipe: settings, rig, experiment, versions", words))
    return section


def _in_words(name: str, value: object) -> str:
    """An attribute as text: lists with commas, numbers that have a unit to four digits and with it."""
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value))
    try:
        return f"{float(str(value)):.4g} {_UNITS[name]}"
    except (KeyError, ValueError):
        return str(value)
