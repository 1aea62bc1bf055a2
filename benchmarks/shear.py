"""A current that falls off with depth, from exact seas: `python -m benchmarks.shear`.

Free waves of 1 to 6 Hz, cos^(2s) (theta / 2) wide, through 1.5 x 2 m, over a current of .1 exp(z / .1 m) m/s
that shifts them as linear theory has it; u and v of the surface are given as they are measured, 2 mm/s off at
random. Of each sea, over the depths that waves reach: the rms error of U(z), the same where every band's
Doppler velocity is put at the depth 1 / 2k, and the first over what is stated. Next to it is what the
bands' own errors allow, the bound of Cramer and Rao for the polynomial that was chosen, and what a polynomial
of that degree leaves out.
"""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from benchmarks.currents import BASIN, SEGMENT, STEP, sea
from benchmarks.options import parser_of
from wavefield.waves import current_by_depth, fit_dispersion, spectrum

SURFACE, FALL, SURFACE_STD = 0.1, 0.1, 0.002  # m/s, m, m/s

Array = NDArray[Any]


def felt(k: Array) -> Array:
    """What a wave feels of the current, 2 k times the integral of U exp(2 k z), m/s."""
    return np.asarray(SURFACE * 2 * k * FALL / (2 * k * FALL + 1))


def profile(s: float, steps: int, seed: int) -> xr.Dataset:
    """Current by depth of one sea; the waves' and the current's direction are drawn."""
    rng = np.random.default_rng(seed)
    heading = 2 * np.pi * rng.random()
    line = 2 * np.pi * np.fft.fftfreq(BASIN, STEP)
    along = felt(np.hypot(line[:, None], line))
    w = sea(s, np.array([along, 0 * along]), np.inf, heading, steps, seed + 1)
    ridge = fit_dispersion(spectrum(w, segment=SEGMENT)["E"])
    given = SURFACE_STD * rng.standard_normal(2)
    return current_by_depth(ridge, surface=(SURFACE + given[0], given[1]), surface_std=SURFACE_STD)


def rms(values: Array) -> float:
    """Root of the mean square, mm/s."""
    return 1e3 * float(np.sqrt(np.mean(values**2)))


def bound(found: xr.Dataset) -> tuple[float, float]:
    """Least rms error of a polynomial of the chosen degree, and what it leaves out, mm/s."""
    degree, z = int(found.attrs["degree"]), found["z"].values
    depths = np.append(found["effective_depth"].values, 0.0)
    errors = np.append(found["doppler_x_std"].values, SURFACE_STD)
    factorials = np.cumprod(np.maximum(np.arange(degree + 1), 1))
    basis = (-depths[:, None]) ** np.arange(degree + 1) / errors[:, None]
    exact = SURFACE / (1 + depths / FALL) / errors
    covariance = np.linalg.inv(basis.T @ basis)
    powers = z[:, None] ** np.arange(degree + 1) / factorials
    least = np.sqrt(np.einsum("zi,ij,zj->z", powers, covariance, powers))
    return rms(least), rms(powers @ covariance @ basis.T @ exact - SURFACE * np.exp(z / FALL))


def row(s: float, steps: int, seed: int) -> tuple[float, float]:
    """Print a line of the table; the error, and that of the depth 1 / 2k."""
    found = profile(s, steps, seed)
    k = found["k_band"].values
    pull = rms((found["doppler_x"].values - felt(k)) / found["doppler_x_std"].values) / 1e3
    z = found["z"].values
    error = found["current_x"].values - SURFACE * np.exp(z / FALL)
    places, values = -found["effective_depth"].values, found["doppler_x"].values
    order = np.argsort(places)
    simple = np.interp(z, np.append(places[order], 0.0), np.append(values[order], SURFACE))
    naive = rms(simple - SURFACE * np.exp(z / FALL))
    stated = float(np.sqrt(np.mean((error / found["current_x_std"].values) ** 2)))
    cells = [
        f"{found.attrs['degree']}",
        f"{pull:.2f}",
        f"{rms(error):.2f}",
        f"{naive:.2f}",
        f"{naive / rms(error):.1f}",
        f"{stated:.1f}",
    ]
    cells += [f"{value:.2f}" for value in bound(found)]
    print(f"| {s:g} | {steps} | {-z[0]:.3f} | {' | '.join(cells)} |", flush=True)
    return rms(error), naive


def main() -> None:
    """Print the table and its summary."""
    parser = parser_of(__doc__)
    parser.add_argument("--steps", type=int, nargs="+", default=[1024, 4096])
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--seas", type=int, default=3, help="of each spread")
    parser.add_argument("--spreads", type=float, nargs="+", default=[0, 5, 10])
    given = parser.parse_args()
    titles = (
        "s", "steps", "down to, m", "degree", "bands: error over stated", "error, mm/s", "at 1/2k",
        "times better", "over stated", "bound", "left out",
    )  # fmt: skip
    print(f"| {' | '.join(titles)} |\n" + "|---" * len(titles) + "|")
    for steps in given.steps:
        found = np.array(
            [
                row(s, steps, given.seed + 100 * i + 10 * j)
                for i, s in enumerate(given.spreads)
                for j in range(given.seas)
            ]
        )
        ratio = found[:, 1] / found[:, 0]
        print(
            f"{steps} steps: error rms {np.sqrt(np.mean(found[:, 0] ** 2)):.2f} mm/s, largest"
            f" {found[:, 0].max():.2f}; times better than 1/2k: median {np.median(ratio):.1f}, least"
            f" {ratio.min():.1f}, three times and more {np.mean(ratio >= 3):.0%}",
            flush=True,
        )


if __name__ == "__main__":
    main()
