"""A light sheet: three components from two and three cameras, and the place of the sheet, from its particles.

    python -m benchmarks.sheet [--seeds N ...] [--frames N]

The scene `sheet` (1 mm thick, .2 mm a pixel, rms displacements 3.7 px along and .75 px across the sheet). The
sheet is 2 mm off the target's plane and is tilted by .8 and -.5 degrees; in the second row camera 1 was
knocked as well. Rows: what the rig as it is measures, and what it does after the self-calibration; errors in
px of .2 mm over all nodes called measured, steps with a frame before and after. A turn along the parallax of
two cameras passes for another height of the sheet and moves x = 0: in the third row of a knocked pair the
truth is taken at the places that the cameras really image.
"""

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.results import parser_of, print_table, save_result
from wavefield.calibration.light_sheet import fit_sheet
from wavefield.measurement import GridGeometry, Settings, measure
from wavefield.rig import Rig
from wavefield.tank import Scene, Tank
from wavefield.tank.light_sheet_scene import plane
from wavefield.variables import Quality

PIXEL = 2e-4  # metres
BESIDE = {"kind": "sheet", "height": 0.002, "tilt": [0.8, -0.5]}
KNOCKED = {"cam1": {"turned": [0.04, 0.03, 0.0]}}
ROWS: dict[str, dict[str, Any]] = {
    "two cameras": {"surface": BESIDE},
    "two cameras, one knocked": {"surface": BESIDE, "faults": KNOCKED},
    "three cameras": {"surface": BESIDE, "rig": {"cameras": 3}},
}

COLUMNS = ("", "seed", "measured", "u, v, w, px", "within one standard uncertainty")


def beside(tank: Tank, rig: Rig) -> NDArray[Any]:
    """Distance of the nodes of a fitted rig from their places in the sheet, (x, y), metres."""
    x, y = np.meshgrid(tank.scene.grid.x_nodes, tank.scene.grid.y_nodes)
    axes, origin = plane(tank.scene.surface)  # type: ignore[arg-type]
    place = np.einsum("ij,jyx->iyx", axes, np.stack([x, y, 0 * x])) + origin[:, None, None]
    seen = tank.rig["cam2"].unproject(*rig["cam2"].project(x, y, 0.0), place[2])  # which was not knocked
    return np.asarray(np.mean(np.stack(seen) - place[:2], axis=(1, 2)))


def errors(
    tank: Tank, images: Sequence[dict[str, NDArray[Any]]], rig: Rig, at: Sequence[float] = (0.0, 0.0)
) -> list[str]:
    """Fraction measured, rms errors of u, v, w and how often they are within their uncertainty."""
    settings = Settings.from_dict({"preset": "sheet", "sheet_thickness": 1e-3})
    rate = tank.scene.frame_rate
    frames = {name: [None, *(image[name] for image in images), None] for name in rig}
    cube = measure(frames, GridGeometry(rig, tank.scene.grid, settings), rate)
    measured = (cube["quality"] & Quality.MEASURED) != 0
    if not measured.any():
        return ["0 %", "", ""]
    x, y = np.meshgrid(tank.scene.grid.x_nodes + at[0], tank.scene.grid.y_nodes + at[1])
    truth = [tank.population.truth(x, y, tank.time(step + 0.5)) for step in range(1, len(images) - 2)]  # type: ignore[union-attr]
    found, within = [], []
    for name in ("u", "v", "w"):
        exact = np.array([getattr(one, name) for one in truth])
        error = (cube[name] - exact)[measured] / rate / PIXEL
        std = cube[f"{name}_std"][measured] / rate / PIXEL
        found.append(f"{np.sqrt(np.mean(error**2)):.3f}")
        within.append(f"{100 * np.mean(np.abs(error) < std):.0f}")
    return [f"{100 * measured.mean():.1f} %", ", ".join(found), f"{', '.join(within)} %"]


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=[71, 72, 73])
    parser.add_argument("--frames", type=int, default=12)
    options = parser.parse_args(words)
    rows = []
    for name, changes in ROWS.items():
        for seed in options.seeds:
            tank = Tank(Scene.load("sheet").with_(frames=options.frames, seed=seed, **changes))
            images = [tank.render(frame) for frame in range(options.frames)]
            found = fit_sheet(lambda camera, k, i=images: i[k][camera], range(options.frames), tank.rig)  # type: ignore[misc]
            rows.append([f"{name}, rig as it is", str(seed), *errors(tank, images, tank.rig)])
            rows.append([f"{name}, after `rig sheet`", str(seed), *errors(tank, images, found.rig)])
            if found.position_ambiguity:
                moved = beside(tank, found.rig)
                there = f"{1e3 * moved[0]:+.2f}, {1e3 * moved[1]:+.2f} mm beside"
                rows.append([f"the same, {there}", str(seed), *errors(tank, images, found.rig, moved)])
    print_table(COLUMNS, rows)
    if options.save:
        save_result("sheet", COLUMNS, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
