"""Stereo at sea: two cameras on a platform, from lenses and a baseline to elevation and E(omega).

    python -m benchmarks.sea [--seeds N ...] [--frames N] [--folder DIR] [--save]

The scene `sea` (12 m up, 2.5 m apart, the horizon in view, Hs .5 m), simulated anew for each seed unless
DIR/SEED holds it. Rows of a seed: how far the vertical of the cameras and their height are off, from lenses
and a baseline alone, and what is stated; z of exact cameras, and of those found, against the truth at the
nodes; E(omega) of `analyze` (Ez_fusion) where it is marked as valid, from half of the peak's frequency on,
against that of the true elevation at the same nodes. Errors are in px (the mean side of a pixel in the middle
of the grid). Records of 30 s: of 10 s, lines are .11 Hz wide beside a steep peak, and one segment is left.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from benchmarks.results import parser_of, print_table, save_result
from wavefield.calibration.level_on_water import level_experiment
from wavefield.grid import Grid
from wavefield.pipeline.running import run
from wavefield.rig import Rig
from wavefield.rig.field import pixel_size
from wavefield.store.read import open_cube
from wavefield.tank import Scene, simulate
from wavefield.variables import Quality
from wavefield.waves import E_omega, fused_spectra
from wavefield.waves.gains import gain_of

Array = NDArray[Any]
BASELINE = 2.5  # m, of the scene


def turned_to(found: Rig, true: Rig) -> Rig:
    """A levelled rig, its x and y axes turned and moved to those of the true one; tilt and height stay."""
    ways = [rig["left"].R[0, :2] for rig in (found, true)]
    a, b = (np.arctan2(*way[::-1]) for way in ways)
    c, s = np.cos(a - b), np.sin(a - b)
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    middle, there = (np.mean([rig[n].centre for n in rig], axis=0) * [1, 1, 0] for rig in (found, true))
    return found.moved(axes, middle - axes @ there)


def rms(values: Array) -> float:
    """Root mean square of what is a number."""
    return float(np.sqrt(np.nanmean(np.square(values))))


def of_rig(folder: Path) -> tuple[Rig, str]:
    """The rig from lenses and a baseline alone, and how far its vertical and its height are off."""
    true = Rig.load(folder / "truth" / "rig.yaml")
    found = level_experiment(folder / "experiment.yaml", distance=BASELINE)
    off = max(np.degrees(np.arccos(min(1.0, found.rig[n].R[:, 2] @ true[n].R[:, 2]))) for n in true)
    return (
        turned_to(found.rig, true),
        f"tilt {off:.3f} degrees (stated {found.tilt_std:.3f}), "
        f"height {100 * (found.height / true['left'].centre[2] - 1):+.2f} % (stated "
        f"{100 * found.height_std / found.height:.2f} %)",
    )


def of_elevation(folder: Path, rig: Rig) -> str:
    """z, E(omega) and Hs by a rig against the truth."""
    truth = xr.open_zarr(folder / "truth" / "truth.zarr").z.load()
    grid = Scene.load(folder / "scene.yaml").grid
    pixel = pixel_size(rig, grid)
    with TemporaryDirectory() as temporary:
        store = Path(temporary) / "cube.zarr"
        run(_with_grid(folder, grid), store, rig=rig)
        cube = open_cube(store).load()
    error, measured = cube.z.values - truth.values, (cube.quality.values & Quality.MEASURED) != 0
    within = np.mean(np.abs(error[measured]) < cube.z_std.values[measured])
    found = fused_spectra(cube, gain=gain_of(cube))
    true = E_omega(truth.assign_coords(cube.z.coords)).E.values
    peak = int(true.argmax())
    valid = found.valid_fusion.values & (found.frequency.values > 0.5 * found.frequency.values[peak])
    end = np.flatnonzero(valid)[-1]
    hs = [4 * np.nanstd(z) for z in (cube.z.values, truth.values)]
    return (
        f"rms {rms(error[measured]) / pixel:.3f} px of {100 * pixel:.1f} cm, stated "
        f"{rms(cube.z_std.values[measured]) / pixel:.3f}, within 1 std {100 * within:.0f} %, measured "
        f"{100 * measured.mean():.1f} %; E(omega) within "
        f"{100 * np.abs(found.Ez_fusion.values / true - 1)[valid].max():.0f} % to "
        f"{found.frequency.values[end]:.2f} Hz, "
        f"{np.log10(true[peak] / true[end]):.1f} decades below the peak; Hs {hs[0]:.3f} m of {hs[1]:.3f}"
    )


def _with_grid(folder: Path, grid: Grid) -> Path:
    """The lab note with the grid of the truth, beside the other."""
    text = (folder / "experiment.yaml").read_text(encoding="utf-8")
    path = folder / "with_grid.yaml"
    path.write_text(
        text + f"grid: {{x: {list(grid.x)}, y: {list(grid.y)}, step: {grid.step}}}\n", encoding="utf-8"
    )
    return path


def main(words: Sequence[str]) -> int:
    """Simulate and print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--folder", type=Path, help="where simulated seas are, or are put")
    options = parser.parse_args(words)
    rows = []
    with TemporaryDirectory() as temporary:
        for seed in map(str, options.seeds):
            folder = (options.folder or Path(temporary)) / seed
            if not (folder / "truth" / "truth.zarr").exists():
                simulate(Scene.load("sea").with_(seed=int(seed), frames=options.frames), folder)
            rig, off = of_rig(folder)
            exact = Rig.load(folder / "truth" / "rig.yaml")
            rows += [
                [seed, "rig from lenses and a baseline", off],
                [seed, "z, cameras found", of_elevation(folder, rig)],
                [seed, "z, exact cameras", of_elevation(folder, exact)],
            ]
    columns = ("seed", "", "")
    print_table(columns, rows)
    if options.save:
        save_result("sea", columns, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
