"""Figures of a rig: drawings of the cameras with their fields of view, and images with the grid."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from wavefield.figures.style import LINES, panels
from wavefield.grid import Grid
from wavefield.rig import Rig


def rig_views(rig: Rig, grid: Grid) -> Figure:
    """Draw the rig from the side and from above, with the fields of view of the cameras.

    Parameters
    ----------
    rig : Rig
        The cameras.
    grid : Grid
        The nodes of the measurement.

    Returns
    -------
    Figure
    """
    figure, axes = panels(2, height=4.0)
    side, above = axes[0]
    y0 = np.mean(grid.y)
    outline = _rectangle(grid.x, grid.y)
    corners = np.concatenate([outline, *(camera.corners(0.0) for camera in rig.cameras.values())])
    low, high = np.nanmin(corners, axis=0), np.nanmax(corners, axis=0)  # names go outside these lines
    side.plot(grid.x, [0, 0], color="0.2", linewidth=3)
    above.plot(*outline.T, color="0.2", linewidth=2, label="grid on the water at rest")
    for style, (name, camera) in zip(LINES[1:] * len(rig), rig.cameras.items(), strict=False):
        cx, cy, cz = camera.centre
        for end in grid.x:
            side.plot([cx, end], [cz, 0], **style | {"linewidth": 0.8})
        view = np.vstack([camera.corners(0.0), camera.corners(0.0)[:1]])
        above.plot(*view.T, label=f"view of {name}", **style)
        over = (low <= camera.centre[:2]).all() and (camera.centre[:2] <= high).all()
        for ax, height_or_y, free in ((side, cz, cz), (above, cy, high[1] if over else cy)):
            ax.plot(cx, height_or_y, "o", color=style["color"])
            ax.annotate(name, (cx, free), textcoords="offset points", xytext=(0, 7), ha="center")
    side.set(xlabel="x (m)", ylabel="z (m)", title="from the side", aspect="equal")
    side.margins(0.12)
    side.set_ylim(-0.3, 1.2 * max(camera.centre[2] for camera in rig.cameras.values()))
    above.set(xlabel="x (m)", ylabel="y (m)", title="from above", aspect="equal")
    half = float(np.ptp(above.get_xlim())) / 2.6
    above.set_ylim(y0 - half, y0 + half)
    above.margins(x=0.12)
    for ax in axes[0]:
        ax.grid(True, color="0.9", linewidth=0.7)
    figure.legend(loc="outside lower center", ncols=len(rig) + 2, frameon=False, fontsize=9)
    figure.set_layout_engine("constrained", h_pad=0.15)
    return figure


def _rectangle(x: tuple[float, float], y: tuple[float, float]) -> NDArray[np.float64]:
    """Return the corners of a rectangle as a closed line (5, 2); x and y are its lower and upper limits."""
    return np.array([(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1]), (x[0], y[0])], float)


def camera_frames(frames: Mapping[str, np.ndarray], rig: Rig, grid: Grid) -> Figure:
    """Draw a frame of each camera with the outline of the grid, and an enlarged part that shows the seeding.

    Parameters
    ----------
    frames : mapping of str to ndarray, (row, column)
        Frame of each camera.
    rig : Rig
        The cameras, by the same names.
    grid : Grid
        The nodes of the measurement.

    Returns
    -------
    Figure
    """
    figure, axes = panels(len(frames), 2, width=4.0, height=3.7)
    x, y = grid.x_nodes, grid.y_nodes
    outline_x = np.concatenate([x, np.full(y.size, x[-1]), x[::-1], np.full(y.size, x[0])])
    outline_y = np.concatenate([np.full(x.size, y[0]), y, np.full(x.size, y[-1]), y[::-1]])
    for (top, bottom), (name, image) in zip(axes.T, frames.items(), strict=True):
        camera = rig[name]
        low, high = np.percentile(image, (1, 99.7))
        grey = {"cmap": "gray", "vmin": low, "vmax": max(high, low + 1)}
        top.imshow(image, **grey)
        top.plot(*camera.project(outline_x, outline_y, 0.0), color="#F0E442", linewidth=1.5)
        h, w = image.shape
        top.set(
            title=name, xlim=(-0.5, w - 0.5), ylim=(h - 0.5, -0.5), xlabel="column (px)", ylabel="row (px)"
        )
        middle = np.mean(grid.x), np.mean(grid.y)
        cx, cy = (float(v) for v in camera.project(*middle, 0.0))
        half = 0.05 * float(np.abs(np.linalg.det(camera.jacobian(*middle, 0.0)[:, :2])) ** 0.5)
        bottom.imshow(image, interpolation="nearest", **grey)
        bottom.set(xlim=(cx - half, cx + half), ylim=(cy + half, cy - half))
        bottom.set(title=f"{name}, middle 10 cm", xlabel="column (px)", ylabel="row (px)")
        zoomed = _rectangle((cx - half, cx + half), (cy - half, cy + half))
        top.plot(*zoomed.T, color="#56B4E9", linewidth=1.2)
    return figure
