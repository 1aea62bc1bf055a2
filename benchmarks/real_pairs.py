"""Real pairs of particle images, matched with default settings, beside OpenPIV and pivtools.

    python -m benchmarks.real_pairs FOLDER [--python PATH]

FOLDER holds the samples (Karman, Oseen, Jet, wake_legi, Milestone). PATH is a Python in which OpenPIV and
pivtools are installed, as for `benchmarks.peers`; windows 64-32-32, overlap 50 %. Differences are medians
over the vectors of the other program that ours calls valid.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from benchmarks.matching import WEAK_PARTICLES
from benchmarks.options import parser_of
from benchmarks.peers import OPENPIV, PIVTOOLS
from wavefield.images import read_image
from wavefield.matching import Displacement, match

PAIRS = {
    "Karman 1-2": ("Karman/Images/Karman_01.bmp", "Karman/Images/Karman_02.bmp"),
    "Karman 3-4": ("Karman/Images/Karman_03.bmp", "Karman/Images/Karman_04.bmp"),
    "Oseen": ("Oseen/Images/Oseen_center_01.tif", "Oseen/Images/Oseen_center_02.tif"),
    "Jet 60": ("Jet/Images/c060a.png", "Jet/Images/c060b.png"),
    "Jet 61": ("Jet/Images/c061a.png", "Jet/Images/c061b.png"),
    "wake_legi": ("wake_legi/images/B00001A.png", "wake_legi/images/B00001B.png"),
    "Milestone": ("Milestone/Images/im00505a.png", "Milestone/Images/im00505b.png"),
}
_ASKED = """
import sys, logging
import numpy as np
logging.disable(logging.CRITICAL)
images = np.load(sys.argv[1])
a, b = images["a"], images["b"]
{program}
x, y, u, v = (np.asarray(field, float) for field in run())
np.savez(sys.argv[2], x=x, y=y, u=u, v=v)
"""
PROGRAMS = {
    "OpenPIV": OPENPIV.replace("{overlap}", "16").replace("return int(u.size)", "return x, y, u, v"),
    "pivtools": PIVTOOLS.replace(
        "return int((found[0] if isinstance(found, (list, tuple)) else found).passes[-1].ux_mat.size)",
        "last = (found[0] if isinstance(found, (list, tuple)) else found).passes[-1]\n"
        "    return *np.meshgrid(last.win_ctrs_x, last.win_ctrs_y), last.ux_mat, last.uy_mat",
    ),
}


def asked(python: str, program: str, folder: Path) -> dict[str, NDArray[np.float64]] | str:
    """Vectors of another program; a sentence where it cannot be run."""
    script = _ASKED.replace("{program}", program)
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    done = subprocess.run(
        [python, "-c", script, str(folder / "pair.npz"), str(folder / "found.npz")],
        capture_output=True,
        text=True,
        env=os.environ | one,
    )
    if done.returncode:
        return (done.stderr.strip().splitlines() or ["no reason given"])[-1]
    with np.load(folder / "found.npz") as found:
        return dict(found)


def difference(ours: Displacement, found: dict[str, NDArray[np.float64]]) -> str:
    """Median and 90th percentile, px."""
    column = (found["x"] - ours.x[0]) / (ours.x[1] - ours.x[0])
    line = (found["y"] - ours.y[0]) / (ours.y[1] - ours.y[0])
    u, v, valid = (
        map_coordinates(field.astype(float), [line, column], order=1, mode="nearest")
        for field in (ours.u, ours.v, ours.valid)
    )
    good = (valid > 0.999) & np.isfinite(found["u"] + found["v"])
    # programs count v up or down, and one counts the first image against the second
    signs = [(s, t) for s in (1, -1) for t in (1, -1)]
    apart = [np.hypot(u - s * found["u"], v - t * found["v"])[good] for s, t in signs]
    least = min(apart, key=lambda d: float(np.median(d)))
    return f"{np.median(least):.3f}, {np.percentile(least, 90):.3f}"


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--python", default=sys.executable, help="where the other programs are installed")
    options = parser.parse_args(words)
    print(f"| pair | valid | {' | '.join(f'from {n}: median, 90 %, px' for n in PROGRAMS)} |")
    print("|---|---|" + "---|" * len(PROGRAMS))
    for name, files in PAIRS.items():
        a, b = (read_image(options.folder / file) for file in files)
        ours = match(a, b, WEAK_PARTICLES if name == "Milestone" else None)
        cells = []
        with tempfile.TemporaryDirectory() as place:
            np.savez(Path(place) / "pair.npz", a=a, b=b)
            for program in PROGRAMS.values():
                found = asked(options.python, program, Path(place))
                cells.append(found if isinstance(found, str) else difference(ours, found))
        print(f"| {name} | {100 * ours.valid.mean():.1f} % | {' | '.join(cells)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
