"""The calibration target as it was found in the images."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from wavefield.calibration import TargetPoints
from wavefield.calibration.target_images import TargetRig, is_table
from wavefield.figures.style import LINES, file_of, panels
from wavefield.images import read_image
from wavefield.rig import Rig


def target_points(
    images: Mapping[str, np.ndarray], points: Mapping[str, TargetPoints], rig: Rig | None, mesh: float
) -> Figure:
    """One image (row, column) of the target per camera with the nodes found, and (with a rig) these on z = 0.
    A circle marks the origin. Counterpart of the paper's calibration grid with its reference points.
    """
    figure, axes = panels(len(images), 1 if rig is None else 2, width=4.0, height=3.8)
    marks = {"marker": "+", "linestyle": "", "color": LINES[2]["color"], "markersize": 5}
    for column, (name, image) in zip(axes.T, images.items(), strict=True):
        found, (h, w) = points[name], image.shape
        low, high = np.percentile(image, (1, 99.8))
        column[0].imshow(image, cmap="gray", vmin=low, vmax=max(high, low + 1))
        column[0].plot(*found.pixel.T, **marks)
        column[0].set(xlim=(-0.5, w - 0.5), ylim=(h - 0.5, -0.5), xlabel="column (px)", ylabel="row (px)")
        column[0].set_title(f"{name}: {len(found)} nodes")
        if rig is None or name not in rig.cameras:
            continue
        origin = rig[name].project(0.0, 0.0, 0.0)  # a disc marks it on the target, and hides the node there
        column[0].plot(*origin, "o", color="#F0E442", fillstyle="none", markersize=14)
        column[1].plot(*rig[name].unproject(*found.pixel.T), **marks)
        column[1].set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=f"{name}, at z = 0")
        for axis in (column[1].xaxis, column[1].yaxis):
            low, high = axis.get_view_interval()
            axis.set_major_locator(MultipleLocator(mesh * max(1, round((high - low) / mesh / 6))))
        column[1].grid(True, color="0.85", linewidth=0.6)
    return figure


def draw_found(result: TargetRig) -> bytes | None:
    """Draw the nodes found in one image of each camera as a PNG: the flat pose where there is one."""
    poses = {
        camera: "flat" if "flat" in found else max(found, key=lambda pose: len(found[pose]))
        for camera, found in result.views.items()
        if found and not any(is_table(path) for path in result.images[camera].values())
    }
    if not poses:
        return None
    rig = result.calibration.rig
    figure = target_points(
        {camera: read_image(result.images[camera][pose]) for camera, pose in poses.items()},
        {camera: result.views[camera][pose] for camera, pose in poses.items()},
        rig if len(rig) and set(poses.values()) == {"flat"} else None,
        result.mesh,
    )
    return file_of(figure, dpi=110, metadata={"Software": "wavefield"})
