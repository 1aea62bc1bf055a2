"""Estimators of single subjects on random seas whose truth is known: `python -m benchmarks.estimators`.

Seas of `tests/waves`, each drawn with another seed: waves that keep their phase for a known time
(`ridge_broadening`), that decay at known rates (`energy_flux`), two systems that follow each other
(`wavelet_directions`), and a second-order sea (`linear_surface`). Per quantity: errors within one and two
standard uncertainties, the largest over its own, and the part of seas that was refused.
"""

import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "waves"))

import test_energy_flux
import test_linear_surface
import test_ridge_broadening
import test_wavelet_directions

from benchmarks.options import parser_of
from benchmarks.results import save_result
from wavefield.errors import CubeError

Array = NDArray[Any]

ESTIMATORS = {
    "ridge_broadening": test_ridge_broadening.errors_of,
    "energy_flux": test_energy_flux.errors_of,
    "wavelet_directions": test_wavelet_directions.errors_of,
    "linear_surface": test_linear_surface.errors_of,
}
COLUMNS = ("estimator", "quantity", "seas", "refused", "within 1 std (68 %)", "within 2 std", "largest")


def rows_of(name: str, seeds: range) -> Iterator[list[str]]:
    """Rows of the table of an estimator."""
    found: dict[str, list[Array]] = defaultdict(list)
    refused = 0
    for seed in seeds:
        try:
            for quantity, errors in ESTIMATORS[name](seed).items():
                found[quantity].append(errors[np.isfinite(errors)])
        except CubeError:
            refused += 1
    for quantity, parts in found.items():
        off = np.abs(np.concatenate(parts))
        shares = [f"{100 * (off < n).mean():.0f} %" for n in (1, 2)]
        yield [name, quantity, str(len(seeds)), str(refused), *shares, f"{off.max():.1f}"]


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--first", type=int, default=800, help="seed of the first sea")
    parser.add_argument("--seas", type=int, default=20)
    parser.add_argument("--save", action="store_true", help="write the result for the validation page")
    given = parser.parse_args()
    start = time.perf_counter()
    print("| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS))
    rows = []
    for name in ESTIMATORS:
        for row in rows_of(name, range(given.first, given.first + given.seas)):
            print("| " + " | ".join(row) + " |", flush=True)
            rows.append(row)
    if given.save:
        save_result("estimators", COLUMNS, rows)
    print(f"\n{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
