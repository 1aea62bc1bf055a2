"""The 4th PIV Challenge's case E in fluidimage's samples: marked dots and vectors beside those found here.

    python -m benchmarks.case_e FOLDER CUBE RIG

FOLDER is `4th_PIV-Challenge_Case_E` of the samples, CUBE and RIG what docs/real-images.md makes of it.
Printed are the differences of the plate's dots from those marked by hand in each image, px (their median,
which is a convention of where a pixel is, and the rms about it), and those of the displacements of each
camera, as the cube has them, from fluidimage's vectors.
"""

import re
import sys
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
from scipy.interpolate import griddata

import wavefield as wf
from benchmarks.options import parser_of
from wavefield.calibration import Target, find_target
from wavefield.images import read_image
from wavefield.rig import Rig
from wavefield.variables import Quality

PLATE = Target("two-level", mesh=0.0075, depth=0.003, diameter=0.0034)
MARKED = re.compile(r"<PointCoord[^>]*>\s*([^<]*)<")
INTERVAL = 0.01  # s, as in the lab note


def marked(path: Path) -> dict[tuple[int, int], np.ndarray]:
    """Dots marked by hand, by their nodes; UVMAT's file is in cm."""
    rows = [[float(word) for word in text.split()] for text in MARKED.findall(path.read_text())]
    return {(round(x / 0.75), round(y / 0.75)): np.array(pixel) for x, y, _, *pixel in rows}


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("cube", type=Path)
    parser.add_argument("rig", type=Path)
    options = parser.parse_args(words)
    for camera in ("1", "3"):
        folder = options.folder / f"E_Calibration_Images/Camera_0{camera}"
        for k in range(7):
            points = find_target(read_image(folder / f"E_camera_{camera}_z_{k + 1}.tif"), PLATE)
            by_hand = marked(folder / f"img_{k}.xml")
            nodes = map(tuple, points.node.tolist())
            pairs = [(at, by_hand[n]) for n, at in zip(nodes, points.pixel, strict=True) if n in by_hand]
            apart = np.array([here - there for here, there in pairs])
            shift = np.median(apart, axis=0)
            rms = np.sqrt(np.mean((apart - shift) ** 2))
            print(
                f"camera {camera}, image {k + 1}: {len(points)} dots, {len(apart)} marked, {shift}, {rms:.2f}"
            )
    cube, rig = wf.open_cube(options.cube).isel(time=0), Rig.load(options.rig)
    x, y = np.meshgrid(cube.x.values, cube.y.values)
    moved = [0.5 * INTERVAL * cube[name].values for name in ("u", "v", "w")]
    measured = (cube.quality.values & Quality.MEASURED) > 0
    print(f"{100 * measured.mean():.1f} % of the nodes are measured")
    for camera in ("1", "3"):
        before, after = (
            np.array(rig[camera].project(x + s * moved[0], y + s * moved[1], s * moved[2])) for s in (-1, 1)
        )
        with h5py.File(
            options.folder / f"E_Particle_Images/Camera_0{camera}.piv/piv_00001-00002.h5"
        ) as stored:
            xs, ys, dx, dy = (stored["piv1"][name][:] for name in ("xs", "ys", "deltaxs", "deltays"))
        good = np.isfinite(dx + dy)
        at = 0.5 * (before + after)[:, measured]
        theirs = griddata((xs[good], ys[good]), np.stack([dx, dy], -1)[good], tuple(at))
        apart = np.hypot(*((after - before)[:, measured].T - theirs).T)
        print(
            f"camera {camera}: median difference {np.nanmedian(apart):.3f} px of {np.isfinite(apart).sum()}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
