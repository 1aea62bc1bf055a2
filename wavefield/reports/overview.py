"""What was measured, by which cameras, with which recipe."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from wavefield import figures
from wavefield.reports.html_page import Listing, Picture, ReportSection, Table, Text
from wavefield.reports.number_text import number, rms_of, without_folders
from wavefield.reports.sources import Sources
from wavefield.rig.pairs import pairs_of
from wavefield.variables import FrameStatus, Quality


def summary(sources: Sources) -> ReportSection:
    """Build the first screen: what was measured, how much of it, how well."""
    cube = sources.cube
    part = sources.thinned("z", "u", "v", "w", "eps_y", "eps_piv", "quality")
    nothing = np.uint16(Quality.OUTSIDE | Quality.MASKED)  # older cubes hold 8 bits
    seen = (part.quality != 0) & ((part.quality & nothing) == 0)
    measured = ((part.quality & int(Quality.MEASURED)) != 0).sum() / max(int(seen.sum()), 1)
    status = cube.frame_status.values
    rate = float(cube.attrs["frame_rate"])
    grid = sources.grid
    ny, nx = cube.sizes["y"], cube.sizes["x"]
    rows = [
        ("steps", f"{cube.sizes['time']} at {rate:g} Hz, {cube.sizes['time'] / rate:.4g} s"),
        (
            "how steps ended",
            ", ".join(
                f"{int((status == s).sum())} {s.name.lower().replace('_', ' ')}"
                for s in FrameStatus
                if (status == s).any()
            ),
        ),
        ("grid", f"{nx} x {ny} nodes, {grid.step * 100:g} cm apart"),
        *(
            [("velocities", f"along paths of {int(cube.path_frames)} frames")]
            if "path_frames" in cube.coords
            else []
        ),
        *(
            [("uncertainty of z = 0, common to all nodes", number(1e3 * float(cube.z_level_std), "mm"))]
            if "z_level_std" in cube
            else []
        ),
        ("measured nodes in view", f"{100 * float(measured):.2f} %"),
        *_left_out(part.quality, seen, cube.attrs.get("cameras", ())),
        ("rms of z about its mean", number(100 * float(part.z.std()), "cm")),
        ("rms of u, v, w", ", ".join(number(100 * rms_of(part[n])) for n in "uvw") + " cm/s"),
        (
            "mismatch of sight lines (eps_y), rms",
            number(1e3 * rms_of(part.eps_y), "mm") + "; 0.4 to 0.8 mm has been published of such a rig",
        ),
        (
            "misfit of the displacements (eps'), rms",
            number(rms_of(part.eps_piv), "px") + "; 0.34 to 0.37 px has been published of such a rig",
        ),
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
                rows.append((label, number(factor * float(statistics[name]), unit)))
    items: list[Any] = [Table("The run in numbers", ("quantity", "value"), rows)]
    if sources.notes:
        items.append(Text("Not in this report: " + "; ".join(sources.notes) + "."))
    return ReportSection("Summary", items)


def _left_out(quality: xr.DataArray, seen: xr.DataArray, cameras: Sequence[str]) -> list[tuple[str, str]]:
    """Cameras without which nodes were measured, and how many."""
    shares = []
    for place, camera in enumerate(cameras):
        bit = np.uint16(Quality.without(place) & ~Quality.FEWER_CAMERAS)
        share = float(((quality & bit) != 0).sum()) / max(int(seen.sum()), 1)
        if share > 0:
            shares.append(f"{camera} {100 * share:.2f} %")
    return [("nodes measured without", ", ".join(shares))] if shares else []


def setup(sources: Sources) -> ReportSection:
    """Build the part on cameras and frames."""
    section = ReportSection("Set-up")
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


_UNITS = {"frame_rate": "Hz", "measured_frame_rate": "Hz", "pixel_size": "m", "water_depth": "m"}


def _with_unit(name: str, words: str) -> str:
    """An attribute as people write it: numbers that have a unit to four digits and with it."""
    try:
        return f"{float(words):.4g} {_UNITS[name]}"
    except (KeyError, ValueError):
        return words


def recipe(sources: Sources) -> ReportSection:
    """Build the part on how the cube was made."""
    folder = str(sources.experiment.path.absolute().parent) if sources.experiment else ""
    attrs = {k: v for k, v in sources.cube.attrs.items() if k not in ("recipe", "fingerprints")}
    rows = [
        (name.replace("_", " "), _with_unit(name, _plain(without_folders(value, folder))))
        for name, value in attrs.items()
        if len(str(value)) < 300
    ]
    section = ReportSection("Recipe", [Table("What the cube says of itself", ("", ""), rows)])
    if sources.recipe:
        words = json.dumps(without_folders(sources.recipe, folder), indent=1)
        section.items.append(Listing("The recipe: settings, rig, experiment, versions", words))
    return section


def _plain(value: Any) -> str:
    """A list as people write it."""
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
