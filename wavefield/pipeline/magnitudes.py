"""Checks that lengths and speeds are plausible in metres and seconds: rig, grid, depth, ranges to search."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError, RigError
from wavefield.grid import Grid
from wavefield.quality.remarks import MIN_COVERAGE, MIN_USEFUL_COVERAGE
from wavefield.rig import Camera, Rig
from wavefield.rig.field import common_field, pixel_sides, pixel_size
from wavefield.series import Experiment
from wavefield.store.verdict import Remark

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, Settings

_CAMERA_DISTANCES = (0.02, 200.0)  # m from the water: a macro lens, and a platform at sea
_MAX_BASELINE = 20.0  # m; cameras on ships and platforms are 2 to 10 m apart
_MAX_DEPTH_DISTANCES = (
    10.0  # depth over the distance of the cameras; waves in view do not feel deeper bottoms
)
_MAX_SPEED = 30.0  # m/s, of water: faster than the crest of any breaking wave
_MAX_LENS_ERROR = 0.5  # px
_MAX_SENSOR_TILT = 0.8  # rad
_MIN_WATER_SHARE = 0.1  # of an image: the rest may be above the horizon
_MAX_NODES_TRIED = 300  # along each side of a grid, for the common view
_MIN_STEP_PIXELS = 0.1  # between nodes: a finer grid holds no more
_MIN_BLOCKS = 21  # along the longer side of what is matched
_MAX_ELEVATION_SHARE = 0.5  # of the distance of the nearest camera
_MAX_THICKNESS_SHARE = 0.05  # of that distance, for beads and light sheets


def refuse_implausible_rigs(experiment: Experiment, rig: Rig, rig_file: str) -> None:
    """Refuse cameras at distances that cannot be metres, lenses that fold images, and cameras under water."""
    refuse_own_frame(rig, rig_file)
    distance = float(np.median(_distances(rig)))
    low, high = _CAMERA_DISTANCES
    if not low <= distance <= high:
        raise RigError(
            f"{rig_file}: its cameras are {distance:.3g} m away from the water; are its lengths in metres? "
            "`wavefield rig convert FILE --unit UNIT` converts another program's"
        )
    for name, camera in rig.cameras.items():
        tilt = max(abs(camera.tau_x), abs(camera.tau_y))
        if not _lens_error(camera) < _MAX_LENS_ERROR or tilt > _MAX_SENSOR_TILT:
            raise RigError(
                f"{rig_file}: the lens of {name} maps several pixels to the same place on the water, or to "
                "none; check its distortion, tilt and focal length"
            )
    level = experiment.water.level
    under = [name for name, camera in rig.cameras.items() if camera.centre[2] <= 0 < camera.centre[2] + level]
    if under:
        raise ExperimentError(
            f"{experiment.path}: water.level of {level:g} m is above {', '.join(under)}; it is in metres"
        )


def refuse_own_frame(rig: Rig, rig_file: str) -> None:
    """Refuse a rig in the frame of one of its cameras, where z = 0 is not the water."""
    if rig.lenses_alone:
        raise RigError(
            f"{rig_file} contains lenses and no positions of the cameras; two at sea are placed by "
            "`wavefield rig level EXPERIMENT --distance METRES -o rig.yaml`, with the distance between them"
        )
    for name, camera in rig.cameras.items():
        if np.allclose(camera.centre, 0.0, atol=1e-9):
            raise RigError(
                f"{rig_file} is in the frame of {name} itself, in which z = 0 is not the water; level it "
                "with `wavefield rig level EXPERIMENT --rig RIG -o rig.yaml`, or by a seeded record at "
                "rest with `wavefield refine`"
            )


def _lens_error(camera: Camera) -> float:
    """Median distance, px, between pixels and the projections of their places on the water."""
    width, height = camera.size
    column, row = np.meshgrid(np.linspace(0, width - 1, 7), np.linspace(0, height - 1, 7))
    with np.errstate(all="ignore"):
        there = camera.project(*camera.unproject(column, row), 0.0)
        apart = np.hypot(there[0] - column, there[1] - row)
    on_water = np.isfinite(apart)
    return float(np.median(apart[on_water])) if on_water.mean() > _MIN_WATER_SHARE else float("inf")


def expected_coverage(rig: Rig, grid: Grid) -> float:
    """Share of the grid's nodes, at most some hundred along each side, that every camera sees at rest."""
    x, y = (nodes[:: 1 + len(nodes) // _MAX_NODES_TRIED] for nodes in (grid.x_nodes, grid.y_nodes))
    visible = np.ones((len(y), len(x)), bool)
    with np.errstate(all="ignore"):  # a grid in another unit may be anywhere
        for name in rig:
            visible &= rig[name].sees(x[None, :], y[:, None], 0.0)
    return float(visible.mean())


def refuse_unseen_grids(experiment: Experiment, rig: Rig, grid: Grid) -> None:
    """Refuse a grid that the cameras hardly see."""
    share = expected_coverage(rig, grid)
    if share >= MIN_USEFUL_COVERAGE:
        return
    blind = [name for name in rig if not expected_coverage(replace(rig, cameras={name: rig[name]}), grid)]
    if len(blind) == len(rig.cameras):
        who = "no camera sees the grid"
    elif blind:
        who = f"{', '.join(blind)} does not see the grid"
    else:
        who = f"the cameras have {100 * share:.2g} % of the grid in common view"
    raise ExperimentError(
        f"{experiment.path}: {who} (x {grid.x[0]:g} to {grid.x[1]:g} m, y {grid.y[0]:g} to {grid.y[1]:g} m); "
        f"{_suggested_grid(rig, grid)}"
    )


def _suggested_grid(rig: Rig, grid: Grid) -> str:
    """The grid in centimetres or millimetres if most of it is in view then, else what all cameras see."""
    pixel = min(_pixels(rig))
    for factor in (0.01, 0.001):
        (x0, x1), (y0, y1) = ((factor * low, factor * high) for low, high in (grid.x, grid.y))
        for step in (factor * grid.step, grid.step):
            fits = step <= min(x1 - x0, y1 - y0) and step >= pixel
            if fits and expected_coverage(rig, meant := Grid((x0, x1), (y0, y1), step)) >= MIN_COVERAGE:
                return f"`grid` is in metres: did you mean {_spelled(meant)}?"
    try:
        field = _spelled(common_field(rig.cameras.values()))
    except RigError as error:
        return f"correct `grid`, which is in metres, or the rig: {error}"
    return f"correct `grid`, which is in metres: the cameras see {field}; or leave it out to have it chosen"


def _spelled(grid: Grid) -> str:
    (x0, x1), (y0, y1) = grid.x, grid.y
    return f"{{x: [{x0:g}, {x1:g}], y: [{y0:g}, {y1:g}], step: {grid.step:g}}}"


def refuse_fine_grids(experiment: Experiment, rig: Rig, grid: Grid, rig_file: str) -> None:
    """Refuse a grid whose step is far below a pixel: it or the rig is not in metres."""
    pixel = min(_pixels(rig))
    if experiment.grid != "auto" and grid.step < _MIN_STEP_PIXELS * pixel:
        raise ExperimentError(
            f"{experiment.path}: grid.step of {grid.step:g} m is far below the size of a pixel on the water, "
            f"{pixel:.2g} m by {rig_file}; are both in metres? Four pixels are a good step"
        )


def refuse_high_water(settings: "Settings", rig: Rig, source: str) -> None:
    """Refuse elevations that come near the cameras, and beads or sheets too thick to be in metres."""
    distance = min(_distances(rig))
    for name, value, share in (
        ("z_range", settings.z_range, _MAX_ELEVATION_SHARE),
        ("bead_height", settings.bead_height, _MAX_THICKNESS_SHARE),
        ("sheet_thickness", settings.sheet_thickness, _MAX_THICKNESS_SHARE),
    ):
        largest = float(np.abs(value or 0.0).max())
        if largest > share * distance:
            raise ExperimentError(
                f"{source}: settings.{name} of {largest:g} m does not fit below cameras that are "
                f"{distance:.2g} m away from the water; it is in metres"
            )


def refuse_small_fields(geometry: "GridGeometry", source: str) -> None:
    """Refuse a field of too few blocks of pixels to learn a spectrum from."""
    shapes = {"the grid": geometry.lattice.shape}
    shapes |= {f"what {name} sees of the grid": s.lattice.shape for name, s in geometry.sights.items()}
    for name, (rows, columns) in shapes.items():
        if max(rows, columns) < _MIN_BLOCKS:
            raise ExperimentError(
                f"{source}: {name} is too small: {columns} x {rows} blocks of pixels are matched, but "
                f"{_MIN_BLOCKS} along the longer side are needed; enlarge `grid`, or leave it out"
            )


def remark_on_lengths(experiment: Experiment, rig: Rig, z: NDArray[np.floating]) -> Iterator[Remark]:
    """Report a distance between cameras or a depth of the water that is unlikely to be metres."""
    name = experiment.path.name
    pairs = list(combinations(rig, 2))
    apart = [float(np.linalg.norm(np.subtract(rig[a].centre, rig[b].centre))) for a, b in pairs]
    baseline = max(apart, default=0.0)
    if baseline > _MAX_BASELINE:
        yield Remark(
            "rig",
            "lengths",
            "remark",
            f"{' and '.join(pairs[apart.index(baseline)])} are {baseline:.3g} m apart (at most "
            f"{_MAX_BASELINE:g} m)",
            "If the rig is not in metres, every elevation and velocity is wrong by that factor",
            "`wavefield rig convert FILE --unit UNIT` converts another program's rig",
            {"baseline": baseline},
        )
    depth = experiment.water.depth
    if depth is None:
        return
    lowest = float(np.nanmin(z, initial=0.0)) if np.isfinite(z).any() else 0.0
    distance = float(np.median(_distances(rig)))
    if -lowest > depth:
        found = f"the surface is {-lowest:.2g} m below still water in the step tried"
    elif depth > _MAX_DEPTH_DISTANCES * distance:
        found = f"the cameras are only {distance:.2g} m away from the water"
    else:
        return
    yield Remark(
        "water",
        "lengths",
        "remark",
        f"water.depth of {name} is {depth:g} m, but {found}",
        "Dispersion and depth correction would be wrong",
        "Is it in metres? Leave it out where the waves in view are too short to feel the bottom",
        {"depth": depth, "lowest": lowest, "distance": distance},
    )


def remark_on_speed(experiment: Experiment, rig: Rig, grid: Grid, pixels: float) -> Iterator[Remark]:
    """Report water that moves too fast; ``pixels`` is its largest displacement in a step."""
    speed = pixels * pixel_size(rig, grid) * experiment.frame_rate
    if speed > _MAX_SPEED:
        yield Remark(
            "record",
            "frame rate",
            "grave",
            f"the water moves by {pixels:.0f} px from frame to frame, {speed:.3g} m/s at "
            f"{experiment.frame_rate:g} Hz",
            f"No water is that fast (at most {_MAX_SPEED:g} m/s): velocities are wrong by a factor",
            f"Is frame_rate of {experiment.path.name} in Hz, and the rig in metres?",
            {"speed": speed},
        )


def name_of_rig(experiment: Experiment, rig: str | Path | Rig | None) -> str:
    """What to call a rig in a message."""
    if isinstance(rig, Rig):
        return "the rig"
    named = experiment.rig if rig is None else rig
    if isinstance(named, dict):
        return ", ".join(dict.fromkeys(named.values()))
    return str(rig) if rig is not None else str(experiment.resolve(named or "rig.yaml"))


def _middle(camera: Camera) -> tuple[tuple[float, float], np.ndarray]:
    """Place (x, y) of the middle of an image on the water, and the vector to the camera, metres."""
    width, height = camera.size
    x, y = (float(v) for v in camera.unproject(0.5 * (width - 1), 0.5 * (height - 1)))
    centre = np.asarray(camera.centre, float)
    if not (np.isfinite(x) and np.isfinite(y)):
        return (float(centre[0]), float(centre[1])), np.array([0.0, 0.0, centre[2]])
    return (x, y), centre - (x, y, 0.0)


def _distances(rig: Rig) -> list[float]:
    """Distance of each camera from the water in the middle of its image, metres."""
    return [float(np.linalg.norm(_middle(camera)[1])) for camera in rig.cameras.values()]


def _pixels(rig: Rig) -> list[float]:
    """Longer side of each camera's pixel on the water in the middle of its image, metres."""
    return [pixel_sides(camera, *_middle(camera)[0])[1] for camera in rig.cameras.values()]
