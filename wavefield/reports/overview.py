"""Sections on the run: summary, set-up, recipe."""

import json
from collections.abc import Sequence

import numpy as np
import xarray as xr

from wavefield import figures
from wavefield.pipeline import Run
from wavefield.reports.html_page import Listing, Picture, ReportSection, Table
from wavefield.reports.number_text import number, rms_of, without_folders
from wavefield.reports.run_data import in_light_sheet
from wavefield.reports.run_numbers import RunNumbers
from wavefield.rig.pairs import pairs_of
from wavefield.variables import Quality, frames_of_path

_UNITS = {"frame_rate": "Hz", "measured_frame_rate": "Hz", "pixel_size": "m", "water_depth": "m"}
_LONG = 300  # letters: longer attributes are not in the table of metadata


def run_summary(numbers: RunNumbers) -> ReportSection:
    """What was measured, how much of it, how well."""
    run, cube = numbers.run, numbers.run.cube
    eps_y, eps_piv = 1e3 * rms_of(numbers.part.eps_y), rms_of(numbers.part.eps_piv)
    gist = f"displacements differ by {number(eps_piv, 'px', 2)} (rms)"
    if not in_light_sheet(run):
        gist = f"sight lines miss each other by {number(eps_y, 'mm', 2)}, {gist}"
    rows = [("step status", numbers.step_status)]
    if "path_frames" in cube.coords:
        frames = int(cube.path_frames)
        stated = {1: "instantaneous", 2: "displacements over one step"}
        rows.append(("velocities", stated.get(frames, f"along paths of {frames_of_path(frames)} frames")))
    if "z_level_std" in cube:
        level = number(1e3 * float(cube.z_level_std), "mm")
        rows.append(("uncertainty of z = 0, common to all nodes", level))
    misfit = f"{number(eps_piv, 'px')} (published for a similar rig: 0.34 to 0.37 px)"
    mismatch = f"{number(eps_y, 'mm')} (published for a similar rig: 0.4 to 0.8 mm)"
    rows += [
        ("measured nodes in view", f"{100 * numbers.measured_in_view:.2f} %"),
        *without_cameras(numbers.part.quality, numbers.n_in_view, cube.attrs.get("cameras", ())),
        ("rms of z about its mean", number(100 * float(numbers.part.z.std()), "cm")),
        ("mismatch of sight lines (eps_y), rms", mismatch),
        ("misfit of the displacements (eps'), rms", misfit),
    ]
    statistics = run.wave_group("statistics")
    for name, label in (("steepness", "steepness k_p σ"), ("slope_rms", "rms slope")):
        if statistics is not None and name in statistics:
            rows.append((label, number(float(statistics[name]))))
    table = Table("Run summary", ("quantity", "value"), rows)
    return ReportSection("Run summary", [table], folded=True, gist=gist)


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
    section = ReportSection("Set-up", folded=True)
    if run.rig is None:
        return section
    section.gist = f"{len(run.rig)} cameras: {', '.join(run.rig)}"
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
    table = Table("Metadata", ("attribute", "value"), rows)
    version = str(attrs.get("wavefield_version", ""))
    section = ReportSection(
        "Recipe", [table], folded=True, gist=version and f"measured by wavefield {version}"
    )
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
