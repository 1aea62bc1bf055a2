"""Estimators on random seas of an independent generator: `python -m benchmarks.seas`.

Six families of linear seas (broad and clean; tails in noise; rolling off; ending at 2.5 to 4 Hz; bimodal;
shallow) with currents to 0.4 m/s in any direction, spreads from isotropic to s = 50, 16 to 60 s. Of the
fitted current: the error, mm/s, the same over its standard uncertainty, and what was refused.
"""

import sys
import time
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "waves"))

from independent_seas import FAMILIES, Sea, family

from benchmarks.options import parser_of
from benchmarks.results import save_result
from wavefield.errors import CubeError
from wavefield.waves import fit_dispersion, spectrum


def current_of(case: tuple[str, int]) -> tuple[str, int, Any, Any, str]:
    """Family, seed, error of the current, the same over its standard uncertainty, or why it was refused."""
    sea: Sea = family(*case)
    found = spectrum(sea.cube(("w",))["w"])
    try:
        fit = fit_dispersion(found["E"], sea.depth)
    except CubeError as error:
        return *case, None, None, str(error)
    error = np.array([float(fit["current_x"]), float(fit["current_y"])]) - sea.current
    std = np.array([float(fit["current_x_std"]), float(fit["current_y_std"])])
    return *case, error, error / std, ""


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=[500, 505], help="first and last")
    parser.add_argument("--families", nargs="+", default=list(FAMILIES), choices=FAMILIES)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--each", action="store_true", help="print every sea")
    parser.add_argument("--save", action="store_true", help="write the result for the validation page")
    given = parser.parse_args()
    cases = [(name, seed) for name in given.families for seed in range(given.seeds[0], given.seeds[1] + 1)]
    start = time.perf_counter()
    with Pool(given.processes) as pool:
        rows = pool.map(current_of, cases, chunksize=1)
    columns = ("family", "seas", "refused", "rms error, mm/s", "largest", "rms over std", "largest")
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    table = []
    for name in (*given.families, "all"):
        mine = [row for row in rows if name in (row[0], "all")]
        fitted = [row for row in mine if not row[4]]
        if given.each and name != "all":
            for row in mine:
                words = row[4] or f"{1e3 * np.hypot(*row[2]):.1f} mm/s, {np.abs(row[3]).max():.1f} std"
                print(f"{row[0]} {row[1]}: {words}; {family(*row[:2])}")
        cells = [name, str(len(mine)), str(len(mine) - len(fitted)), "", "", "", ""]
        if fitted:
            size = 1e3 * np.array([np.hypot(*row[2]) for row in fitted])
            over = np.abs(np.array([row[3] for row in fitted]))
            rms = [np.sqrt((values**2).mean()) for values in (size, over)]
            cells[3:] = f"{rms[0]:.2f}", f"{size.max():.1f}", f"{rms[1]:.2f}", f"{over.max():.1f}"
        print("| " + " | ".join(cells) + " |")
        table.append(cells)
    if given.save:
        save_result("seas", columns, table)
    print(f"\n{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
