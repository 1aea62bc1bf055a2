"""Figures of a calibration: residuals, target positions, z of the flat target, points found in images."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from wavefield.calibration import TargetPoints
from wavefield.calibration.assess import FlatSurface
from wavefield.calibration.bundle import Fit
from wavefield.calibration.observations import Observations
from wavefield.calibration.target_images import TargetRig, is_table
from wavefield.figures.style import LINES, panels, round_down
from wavefield.images import read_image
from wavefield.reports.numbers import small
from wavefield.rig import Rig
from wavefield.rig.lens import Array

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # of Okabe and Ito (2008)
GREY, PALE = "#555555", "#dddddd"
_POSE_COLOURS = (*COLOURS, GREY, "#000000")
_MIN_POINTS_PER_CELL = 4  # the mean residual of cells with fewer points is not drawn


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _image_frame(axes: Axes, size: tuple[int, int]) -> None:
    axes.set(xlim=(-0.5, size[0] - 0.5), ylim=(size[1] - 0.5, -0.5), aspect="equal")
    axes.set(xlabel="column (px)", ylabel="row (px)")
    axes.tick_params(labelsize=8)


def _draw_arrows(axes: Axes, pixel: Array, residual: Array, length: float, width: float, colour: str) -> None:
    """Draw residuals (n, 2), px, as arrows at the image points `pixel` (n, 2), column and row, px.
    The 90 % quantile of their lengths is drawn `length` px long; `width` is an argument of `quiver`."""
    large = float(np.percentile(np.hypot(*residual.T), 90)) or 1e-9
    arrows = axes.quiver(
        *pixel.T, *residual.T, angles="xy", scale_units="xy", scale=large / length, width=width, color=colour
    )
    key = round_down(large)
    axes.quiverkey(arrows, 0.93, 1.03, key, f"{key:g} px", labelpos="W", fontproperties={"size": 9})


def residual_map(observations: Observations, fit: Fit, camera: int) -> Figure:
    """Draw the residuals in the images of one camera: of every point, and their mean in each image cell.
    `camera` is its index in `observations.cameras`."""
    o = observations
    rows = o.camera == camera
    pixel, miss, size = o.pixel[rows], fit.residual[rows], o.sizes[camera]
    figure = _figure(11.0, 4.3 * size[1] / size[0] + 1.1)
    axes: Sequence[Axes] = figure.subplots(1, 2)
    rms = float(np.sqrt(np.mean(miss**2)))

    _draw_arrows(axes[0], pixel, miss, 0.035 * size[0], 0.0016, COLOURS[0])
    _image_frame(axes[0], size)
    axes[0].set_title("Residual of every point", fontsize=10, loc="left")

    cells = 10, max(3, round(10 * size[1] / size[0]))
    cell = np.floor((pixel + 0.5) / np.array(size) * cells).astype(int).clip(0, np.array(cells) - 1)
    flat = cell[:, 1] * cells[0] + cell[:, 0]
    count = np.bincount(flat, minlength=cells[0] * cells[1])
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.stack([np.bincount(flat, miss[:, k], cells[0] * cells[1]) / count for k in range(2)])
        spread = np.sqrt(np.bincount(flat, np.sum(miss**2, axis=1) / 2, cells[0] * cells[1]) / count)
    extent = (-0.5, size[0] - 0.5, size[1] - 0.5, -0.5)
    darkest = 2.0 * max(rms, 1e-9)
    spread = spread.reshape(cells[::-1])
    picture = axes[1].imshow(spread, extent=extent, cmap="Greys", vmin=0.0, vmax=darkest, alpha=0.8)
    middle = (np.stack(np.meshgrid(np.arange(cells[0]), np.arange(cells[1]))) + 0.5).reshape(2, -1)
    middle = middle * (np.array(size) / cells)[:, None] - 0.5
    enough = count >= _MIN_POINTS_PER_CELL
    if enough.any():
        _draw_arrows(axes[1], middle[:, enough].T, mean[:, enough].T, 0.06 * size[0], 0.005, COLOURS[1])
    _image_frame(axes[1], size)
    axes[1].set_title("Mean residual per cell (systematic part)", fontsize=10, loc="left")
    figure.colorbar(picture, ax=axes[1], label="rms (px)", shrink=0.8, pad=0.02)
    figure.suptitle(
        f"{o.cameras[camera]}: {rows.sum()} points, rms {rms:.3g} px, largest {np.abs(miss).max():.3g} px",
        fontsize=11,
    )
    return figure


def coverage(observations: Observations) -> Figure:
    """Draw the positions of the target's points in the images of each camera, one colour per target pose."""
    o = observations
    count = len(o.cameras)
    figure = _figure(3.9 * count + 0.3, 4.6)
    for c, axes in enumerate(figure.subplots(1, count, squeeze=False)[0]):
        for p in range(len(o.poses)):
            rows = (o.camera == c) & (o.pose == p)
            if rows.any():
                colour, marker = _POSE_COLOURS[p % len(_POSE_COLOURS)], ".+"[p // len(_POSE_COLOURS) % 2]
                axes.plot(*o.pixel[rows].T, marker, ms=2.5, color=colour, label=o.poses[p])
        _image_frame(axes, o.sizes[c])
        axes.set_title(o.cameras[c], fontsize=10, loc="left")
        axes.locator_params(nbins=5)
        if c:
            axes.set_ylabel("")
    handles = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles[label] = handle
    style = {"ncols": 8, "fontsize": 8, "markerscale": 4, "frameon": False}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", **style)
    return figure


def flat_target(surface: FlatSurface, mesh: float) -> Figure:
    """Draw z of the points of the flat target, triangulated with the rig; `mesh` is their spacing, m."""
    figure = _figure(10.4, 6.0)
    axes = figure.subplots()
    kept = surface.plane.kept
    limit = float(np.percentile(np.abs(surface.z[kept]), 98)) * 1e3 or 1e-6
    wide = max(np.ptp(surface.x), np.ptp(surface.y), mesh)
    dots = axes.scatter(
        surface.x, surface.y, s=(0.55 * 500 * mesh / wide) ** 2, edgecolors=PALE, linewidths=0.5,
        c=1e3 * surface.z, cmap="RdBu_r", vmin=-limit, vmax=limit,
    )  # fmt: skip
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    axes.margins(0.06)
    figure.colorbar(dots, label="z (mm)", shrink=0.85)
    axes.set_title(
        f"rms {small(1e3 * surface.rms, 'mm')}, about its plane {small(1e3 * surface.plane.rms, 'mm')}; "
        f"tilt {small(surface.tilt, 'mrad')}",
        fontsize=10,
        loc="left",
    )
    return figure


def target_points(
    images: Mapping[str, np.ndarray], points: Mapping[str, TargetPoints], rig: Rig | None
) -> Figure:
    """Draw one image (row, column) of the target per camera, with the target's `points` found in it.
    With `rig`, a circle marks the origin x = y = z = 0; the target must then lie in the plane z = 0."""
    figure, axes = panels(len(images), width=4.0, height=3.8)
    marks = {"marker": "+", "linestyle": "", "color": LINES[2]["color"], "markersize": 5}
    for ax, (name, image) in zip(axes[0], images.items(), strict=True):
        low, high = np.percentile(image, (1, 99.8))
        ax.imshow(image, cmap="gray", vmin=low, vmax=max(high, low + 1))
        ax.plot(*points[name].pixel.T, **marks)
        _image_frame(ax, image.shape[::-1])
        ax.set_title(f"{name}: {len(points[name])} nodes")
        if rig is not None and name in rig.cameras:  # the target's own disc hides the node at the origin
            ax.plot(*rig[name].project(0.0, 0.0, 0.0), "o", color="#F0E442", fillstyle="none", markersize=14)
    return figure


def draw_found(result: TargetRig) -> Figure | None:
    """Draw one target image per camera with the points found in it, if possible with the target lying flat.
    Cameras whose points were read from a table are left out; the result is None if no camera is left."""
    poses = {
        camera: "flat" if "flat" in found else max(found, key=lambda pose: len(found[pose]))
        for camera, found in result.views.items()
        if found and not any(is_table(path) for path in result.images[camera].values())
    }
    if not poses:
        return None
    rig = result.calibration.rig
    return target_points(
        {camera: read_image(result.images[camera][pose]) for camera, pose in poses.items()},
        {camera: result.views[camera][pose] for camera, pose in poses.items()},
        rig if len(rig) and set(poses.values()) == {"flat"} else None,
    )
