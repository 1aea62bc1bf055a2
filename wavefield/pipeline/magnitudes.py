"""Lengths that cannot be metres: a rig, a grid or a range of elevations given in another unit."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wavefield.errors import ExperimentError, RigError
from wavefield.grid import Grid
from wavefield.rig import Camera, Rig
from wavefield.rig.resolution import pixel_sides
from wavefield.series import Experiment

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, Settings

_UNITS = {"centimetres": 0.01, "millimetres": 0.001}
_CAMERA_DISTANCES = (0.02, 200.0)  # m from the water: nearer or farther ones are given in another unit
_USUAL_DISTANCES = (0.2, 30.0)  # m
_MAX_GRID_FIELDS = 20.0  # times as wide as a camera's field may a grid be
_MIN_STEP_PIXELS = 0.1  # between nodes: finer ones have nothing of their own
_MIN_BLOCKS = 21  # along the longer side of what is matched
_MAX_ELEVATION_SHARE = 0.5  # of the distance of the nearest camera


def refuse_far_cameras(experiment: Experiment, rig: Rig, rig_file: str) -> None:
    """Refuse cameras so far from the water, or so near, that their rig cannot be in metres."""
    distances = np.array([np.linalg.norm(_middle(camera)[1]) for camera in rig.cameras.values()])
    distance = float(np.median(distances))
    low, high = _CAMERA_DISTANCES
    if not low <= distance <= high:
        raise RigError(f"{rig_file}: its cameras are {distance:.3g} m away from the water{_remedy(distance)}")
    level = experiment.water.level
    under = [name for name, camera in rig.cameras.items() if camera.centre[2] <= 0 < camera.centre[2] + level]
    if under:
        raise ExperimentError(
            f"{experiment.path}: water.level of {level:g} m is above {', '.join(under)}; it is in metres"
        )


def refuse_other_grids(experiment: Experiment, rig: Rig, grid: Grid, rig_file: str) -> None:
    """Refuse a grid that does not fit the cameras' field by so much that one of them is not in metres."""
    field = _field(rig)
    if field is None or experiment.grid == "auto":
        return
    extent = max(grid.x[1] - grid.x[0], grid.y[1] - grid.y[0])
    pixel = min(pixel_sides(camera, *_middle(camera)[0])[1] for camera in rig.cameras.values())
    if extent > _MAX_GRID_FIELDS * field or not np.isfinite(extent):
        unit, factor = _unit(extent, field)
        raise ExperimentError(
            f"{experiment.path}: the grid is {extent:.3g} m wide, but the cameras of {rig_file} see only "
            f"{field:.2g} m; if it is in {unit}, multiply `grid` by {factor:g}"
        )
    if grid.step < _MIN_STEP_PIXELS * pixel:
        unit, factor = _unit(field, extent)
        if field > _MAX_GRID_FIELDS * extent:
            raise RigError(
                f"{rig_file}: its cameras see {field:.3g} m, but the grid of {experiment.path} is only "
                f"{extent:.2g} m wide; if the rig is in {unit}, multiply its lengths by {factor:g}"
            )
        raise ExperimentError(
            f"{experiment.path}: grid.step of {grid.step:g} m is far below the size of a pixel on the water, "
            f"{pixel:.2g} m; four pixels are a good step"
        )


def refuse_high_water(settings: "Settings", rig: Rig, source: str) -> None:
    """Refuse elevations that come near the cameras: they are not in metres."""
    room = _MAX_ELEVATION_SHARE * min(
        float(np.linalg.norm(_middle(camera)[1])) for camera in rig.cameras.values()
    )
    lengths: Mapping[str, tuple[float, ...]] = {
        "z_range": settings.z_range or (),
        "bead_height": (settings.bead_height,),
        "sheet_thickness": (settings.sheet_thickness or 0.0,),
    }
    for name, values in lengths.items():
        largest = max((abs(value) for value in values), default=0.0)
        if largest > room:
            unit, factor = _unit(largest, 0.05 * room)
            raise ExperimentError(
                f"{source}: settings.{name} of {largest:g} m does not fit below cameras that are "
                f"{2 * room:.2g} m away; if it is in {unit}, multiply it by {factor:g}"
            )


def refuse_small_fields(geometry: "GridGeometry", source: str) -> None:
    """Refuse a field of too few blocks of pixels: its spectrum has gaps, and nothing is learned from it."""
    shapes = {"the grid": geometry.lattice.shape}
    shapes |= {
        f"what {name} sees of the grid": geometry.sights[name].lattice.shape for name in geometry.sights
    }
    for name, (rows, columns) in shapes.items():
        if max(rows, columns) < _MIN_BLOCKS:
            raise ExperimentError(
                f"{source}: {name} is too small: {columns} x {rows} blocks of pixels are matched, but "
                f"{_MIN_BLOCKS} along the longer side are needed; enlarge `grid`, or leave it out"
            )


def name_of_rig(experiment: Experiment, rig: str | Path | Rig | None) -> str:
    """What to call a rig in a message."""
    if isinstance(rig, Rig):
        return "the rig"
    named = experiment.rig if rig is None else rig
    if isinstance(named, dict):
        return ", ".join(dict.fromkeys(named.values()))
    return str(rig) if rig is not None else str(experiment.resolve(named or "rig.yaml"))


def _unit(length: float, expected: float) -> tuple[str, float]:
    """Unit in which a length comes nearest to an expected one."""
    apart = {unit: abs(np.log(max(length * factor, 1e-300) / expected)) for unit, factor in _UNITS.items()}
    unit = min(apart, key=lambda name: apart[name])
    return unit, _UNITS[unit]


def _remedy(distance: float) -> str:
    fits = [
        f"by {factor:g} if they are {unit} ({distance * factor:.2g} m)"
        for unit, factor in _UNITS.items()
        if _USUAL_DISTANCES[0] <= distance * factor <= _USUAL_DISTANCES[1]
    ]
    words = f"multiply its lengths {' or '.join(fits)}" if fits else "are its lengths in metres?"
    return f"; {words}"


def _middle(camera: Camera) -> tuple[tuple[float, float], np.ndarray]:
    """Where the middle of an image is on the water, (x, y), and the way from there to the camera, metres."""
    width, height = camera.size
    x, y = (float(v) for v in camera.unproject(0.5 * (width - 1), 0.5 * (height - 1)))
    centre = np.asarray(camera.centre, float)
    if not (np.isfinite(x) and np.isfinite(y)):
        return (float(centre[0]), float(centre[1])), np.array([0.0, 0.0, centre[2]])
    return (x, y), centre - (x, y, 0.0)


def _field(rig: Rig) -> float | None:
    """Width of the water that a camera sees, median over the cameras, metres; None if it is not bounded."""
    widths = [max(c.size) * pixel_sides(c, *_middle(c)[0])[1] for c in rig.cameras.values()]
    width = float(np.median(widths))
    return width if np.isfinite(width) and width > 0 else None
