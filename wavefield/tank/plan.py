"""Predict the errors of an experiment before it is built, from one step of a simulated tank."""

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import xarray as xr

from wavefield.measurement import GridGeometry, measure
from wavefield.rig import Rig
from wavefield.rig.field import pixel_size
from wavefield.tank.scene import Scene
from wavefield.tank.tank import Tank
from wavefield.variables import AROUND, Quality

EDGE = 0.04  # m: errors nearer to the edge of the grid are not counted


def plan(
    scene: Scene | str | Path = "demo", *, rig: Rig | Mapping[str, object] | None = None, **changes: object
) -> xr.Dataset:
    """Predict the errors of an experiment from one simulated step of it.

    The function draws images of the scene, measures them, and compares the fields with the exact ones. If the
    grid is large enough, nodes within 4 cm of its edge are left out. A small grid takes a few seconds.

    Parameters
    ----------
    scene : Scene, path or str
        Cameras, grid, waves, beads and light: a scene, its YAML file, or the name of a preset.
    rig : Rig or mapping, optional
        Cameras to use instead, or changed settings of the scene's cameras.
    **changes
        Changed settings of the scene, as in `Scene.with_`: ``surface={"density": 4000}``.

    Returns
    -------
    Dataset, (quantity,)
        For z and the displacements u dt, v dt, w dt over one frame interval. ``error`` is the rms error,
        ``stated`` the rms of the standard uncertainty that the measurement gives, both in px (a pixel is
        ``attrs["pixel_size"]`` metres). ``within`` is the fraction of errors that are smaller than the
        standard uncertainty (68 % if it is right), ``measured`` the fraction of nodes with a measurement.

    Raises
    ------
    ExperimentError
        If a setting of the scene is wrong.

    Examples
    --------
    Half as many beads, on a field of 20 x 16 cm:

    >>> import wavefield as wf
    >>> grid = {"x": (-0.1, 0.1), "y": (-0.08, 0.08), "step": 0.01}
    >>> found = wf.plan(grid=grid, surface={"density": 5000}, light={"bits": 8})  # doctest: +SKIP
    >>> found.error.sel(quantity="z")  # doctest: +SKIP
    """
    with TemporaryDirectory() as folder:
        if isinstance(rig, Rig):
            rig.save(Path(folder) / "rig.yaml")
            changes = {**changes, "rig": {"file": str(Path(folder) / "rig.yaml")}}
        elif rig is not None:
            changes = {**changes, "rig": rig}
        given = scene if isinstance(scene, Scene) else Scene.load(scene)
        frames = 2 * AROUND + 2  # that one step uses
        tank = Tank(given.with_(**changes, frames=frames))
    images: dict[str, list[np.ndarray | None]] = {name: [] for name in tank.rig}
    for number in range(frames):
        for name, image in tank.render(number).items():
            images[name].append(image)
    grid, rate = tank.scene.grid, tank.scene.frame_rate
    measured = measure(images, GridGeometry(tank.rig, grid), rate)
    truth, pixel = tank.truth(AROUND), pixel_size(tank.rig, grid)
    edge = min(round(EDGE / grid.step), (min(grid.shape) - 1) // 2)
    inner = (slice(edge, -edge or None),) * 2
    rows = []
    for name in "zuvw":
        unit = pixel if name == "z" else rate * pixel
        error = (measured[name][0] - getattr(truth, name))[inner] / unit
        std = measured[f"{name}_std"][0][inner] / unit
        there = np.isfinite(error)
        rms = (float(np.sqrt(np.mean(part[there] ** 2))) if there.any() else np.nan for part in (error, std))
        rows.append((*rms, float(np.mean(np.abs(error[there]) < std[there])) if there.any() else np.nan))
    error, stated, within = zip(*rows)
    quality = measured["quality"][0][inner]
    return xr.Dataset(
        {
            "error": ("quantity", list(error), {"long_name": "rms error", "units": "pixel"}),
            "stated": ("quantity", list(stated), {"long_name": "rms of the stated std", "units": "pixel"}),
            "within": ("quantity", list(within), {"long_name": "share within one std", "units": "1"}),
            "measured": ((), float(np.mean((quality & Quality.MEASURED) != 0)), {"units": "1"}),
        },
        {"quantity": ["z", "u dt", "v dt", "w dt"]},
        {"pixel_size": pixel, "frame_rate": rate},
    )
