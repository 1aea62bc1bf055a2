"""Bound waves and B at crests from images: `python -m benchmarks.bound [FOLDER] [--seed 401]`.

A steep sea with the waves that pairs of its waves force is simulated, calibrated and measured below FOLDER
(what is there already is used; a folder that goes if none is given). The part of its energy that is bound is
found from the measured elevation, from the exact one, and from the exact one without its bound waves, and
printed beside the exact part. Then B = u / c at crests, beside that of the exact fields.
"""

import dataclasses
import tempfile
from pathlib import Path

import numpy as np
import xarray as xr

import wavefield as wf
import wavefield.waves as wv
from benchmarks import crests
from benchmarks.options import parser_of
from wavefield.tank import Scene, Sea, simulate


def elevation(sea: Sea, cube: xr.Dataset) -> xr.DataArray:
    """The exact elevation at the nodes and times of a cube, m, (time, y, x)."""
    x, y, rate = cube["x"].values, cube["y"].values, cube.attrs["frame_rate"]
    times = (np.arange(cube.sizes["time"]) + 0.5) / rate
    z = np.stack([sea.on_grid(x, y, now, ("z",))["z"] for now in times]).astype("f4")
    return cube["z"].copy(data=z)


def measured(folder: Path, scene: Scene) -> xr.Dataset:
    """The cube from the images of a scene."""
    experiment, cube = folder / "tank" / "experiment.yaml", folder / "cube.zarr"
    if not cube.exists():
        if not experiment.exists():
            simulate(scene, folder / "tank")
        wf.calibrate(experiment).calibration.rig.save(folder / "tank" / "rig.yaml")
        wf.run(experiment, cube)
    return wf.open_cube(cube)


def bound(z: xr.DataArray, segment: int, depth: float) -> xr.Dataset:
    """Free and bound waves of an elevation."""
    found = wv.spectrum(z, segment=segment)
    return wv.free_and_bound(found["E"], depth, dof=float(found["dof"]))


def tables(folder: Path, scene: Scene, segments: list[int]) -> None:
    """Print a row for each length of the segments, and B at crests."""
    cube = measured(folder, scene)
    sea = scene.sea.build(scene.seed)
    whole, free = elevation(sea, cube), elevation(dataclasses.replace(sea, bound=0), cube)
    print("| segment | exact | from exact fields | from images | from free waves alone |\n|" + "---|" * 5)
    for segment in segments:
        energy = [float(wv.spectrum(z, segment=segment)["E"][2:].sum()) for z in (whole - free, whole)]
        cells = [f"{energy[0] / energy[1]:.5f}"]
        for z in (whole, cube["z"], free):
            part = bound(z, segment, sea.depth)
            cells.append(f"{float(part['bound_fraction']):.5f} +- {float(part['bound_fraction_std']):.5f}")
        print(f"| {segment} | {' | '.join(cells)} |", flush=True)
    truth = xr.open_zarr(folder / "tank" / "truth" / "truth.zarr", chunks=None, consolidated=False)
    crests.print_table(cube, truth)


def main() -> None:
    """Simulate, measure, print."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--frames", type=int, default=391)
    parser.add_argument("--seed", type=int, default=401)
    parser.add_argument("--segments", type=int, nargs="+", default=[128, 192, 256])
    given = parser.parse_args()
    scene = Scene.load("steep").with_(frames=given.frames, seed=given.seed, sea={"shortest": 0.15})
    with tempfile.TemporaryDirectory() as other:
        tables(given.folder or Path(other), scene, given.segments)


if __name__ == "__main__":
    main()
